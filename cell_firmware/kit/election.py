"""Piece *election*: the least key in reach, at bounded distance."""

from __future__ import annotations

from typing import Any

from cell_firmware.kit.gradient import NOBODY
from cell_firmware.scalar_program import scalar_function


@scalar_function
def elect(own: Any, valid: Any, keys: Any, hops: Any, limit: Any) -> Any:
    """Return the leader's key, the distance from the leader, hops, and the side through which it was heard.

    Of all claims in reach the one with the least key counts, and of these the nearest. A claim that no leader renews is
    a hop farther away each time it is passed on, and is dropped at ``limit``: so a dead leader, and a key that no cell
    has, are forgotten. The cell's own last claim has no part in it.

    Source: A. Arora and M. Gouda, "Distributed reset", IEEE Trans. Computers 43 (1994), whose tree bounds distances in
    that way.

    Args:
        own: The cell's own key; keys differ.
        valid: For each side, whether ``keys`` and ``hops`` are valid.
        keys: For each side, the key of the neighbour's leader.
        hops: For each side, the neighbour's distance from that leader.
        limit: Distance at which claims are dropped; must exceed the distance of any two cells.

    Returns:
        Key; distance, 0 for the leader itself; side of the parent, the first of the nearest, ``NOBODY`` for a leader.
    """
    leader, distance, parent = own, 0, NOBODY
    for side in range(4):
        if not valid[side] or hops[side] < 0 or hops[side] + 1 >= limit:
            continue
        if keys[side] < leader or (keys[side] == leader and hops[side] + 1 < distance):
            leader, distance, parent = keys[side], hops[side] + 1, side
    return leader, distance, parent
