"""Piece *gradient*: the distance to the nearest source, and the neighbour that is nearer."""

from __future__ import annotations

from typing import Any

from cell_firmware.scalar_program import scalar_function

NOBODY = 4
"""Side of a cell that has no parent."""


@scalar_function
def descend(is_source: Any, valid: Any, hops: Any, limit: Any) -> Any:
    """Return the cell's distance, hops, and the side of the nearest neighbour.

    The distance is one more than the least valid one around, at most ``limit``, which means no way. The cell's own last
    distance has no part in it: so every error is forgotten.

    Source: the distributed Bellman-Ford algorithm; D. Bertsekas and R. Gallager, *Data Networks*, 2nd ed., 1992,
    section 5.2.4.

    Args:
        is_source: Whether the cell is a source: its distance is 0.
        valid: For each side, whether ``hops`` is valid.
        hops: For each side, the neighbour's distance.
        limit: Distance that stands for no way.

    Returns:
        Distance; side of the first of the nearest neighbours, ``NOBODY`` for a source and without a way.
    """
    distance, side_of_least = limit, NOBODY
    if is_source:
        distance = 0
    for side in range(4):
        if valid[side] and hops[side] >= 0 and hops[side] + 1 < distance:
            distance, side_of_least = hops[side] + 1, side
    return distance, side_of_least
