"""Leader election among cells that sense one parcel: groups, leaders, and a tree to each leader."""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus.lattice import OPPOSITE
from cell_firmware.firmware import Bools

Integers = NDArray[np.int64]

NOBODY: Final = 0xFFFFFFFF
"""Leader of a cell that follows none: above every cell's key."""
_NEWCOMER: Final = 1 << 31
ROOT: Final = 4
"""Side of the parent of a cell that leads, or that has no leader."""
FARTHEST: Final = 40
"""Largest distance of a follower from its leader, hops, which bounds the life of loops."""
FIELDS: Final = [("level", "u1"), ("leader", "<u4"), ("hops", "u1"), ("parent", "u1")]
"""Fields of the election in a message: 7 bytes."""


class ElectionState(NamedTuple):
    """Election state of cells: leader, distance and parent in the tree; arrays ``(n,)`` int64.

    Attributes:
        level: ``halo + 1`` where a parcel is sensed, one less a hop away, 0 outside every group.
        leader: Key of the leader.
        hops: Links to it.
        parent: Side of the neighbour that is one link nearer, or ``ROOT``.
        blocked_leader: Leader that the cell believes to be dead.
        block_ticks: Periods for which this leader's key is ignored.
    """

    level: Integers
    leader: Integers
    hops: Integers
    parent: Integers
    blocked_leader: Integers
    block_ticks: Integers


def keys(row: Integers, column: Integers, leads: Bools) -> Integers:
    """Return election keys, ``(n,)``: the least key of a group leads, and current leaders rank first."""
    return np.where(leads, 0, _NEWCOMER) | row << 16 | column


def levels(covered: Bools, neighbour: NDArray[Any], valid: Bools, halo: int) -> Integers:
    """Return the proximity of a sensed parcel, which decreases by 1 a hop."""
    theirs = np.where(valid, neighbour["level"].astype(np.int64), 0)
    highest = np.maximum(np.maximum(theirs[:, 0], theirs[:, 1]), np.maximum(theirs[:, 2], theirs[:, 3]))
    return np.where(covered, halo + 1, np.maximum(highest, 1) - 1)


def elect(
    own: Integers,
    covered: Bools,
    level: Integers,
    neighbour: NDArray[Any],
    valid: Bools,
    before: ElectionState,
    hold: int,
) -> ElectionState:
    """Compute one round of the election: each cell follows the least key received, by the fewest links.

    Only cells that sense a parcel are candidates. A cell keeps its leader only through neighbours that are no farther
    from it than the cell itself, and blocks the leader's key for a while after that fails. When a leader dies its
    followers therefore drop it in a wave, one hop a period, instead of passing its key around in loops (the feasibility
    condition of distance-vector routing: Garcia-Luna-Aceves, IEEE/ACM Trans. Networking 1, 1993).

    Args:
        own: ``(n,)`` keys of the cells.
        covered: ``(n,)``, whether the cell senses a parcel.
        level: ``(n,)``, result of ``levels``.
        neighbour: ``(n, 4)``, each neighbour's last message, with ``FIELDS``.
        valid: ``(n, 4)``, whether that message is still valid.
        before: State after the previous round.
        hold: Periods for which the key of a dropped leader is blocked.
    """
    bar = np.maximum(before.block_ticks, 1) - 1
    best = np.where(covered, own, NOBODY) << 8
    parent = np.full(len(own), ROOT, dtype=np.int64)
    for side in range(4):
        leader, hops = (
            neighbour["leader"][:, side].astype(np.int64),
            neighbour["hops"][:, side].astype(np.int64),
        )
        stale = (leader == own) | ((bar > 0) & (leader == before.blocked_leader))
        circular = (leader == before.leader) & (hops > before.hops)
        fit = valid[:, side] & (leader != NOBODY) & (hops < FARTHEST) & ~stale & ~circular
        offer = np.where(fit, leader << 8 | (hops + 1), NOBODY << 8)
        nearer = offer < best
        best, parent = np.where(nearer, offer, best), np.where(nearer, side, parent)
    member = level > 0
    leader = np.where(member, best >> 8, NOBODY)
    dropped = (before.leader != leader) & (before.leader != NOBODY) & (before.leader < leader)
    return ElectionState(
        level,
        leader,
        np.where(member, best & 0xFF, 0),
        np.where(member, parent, ROOT),
        np.where(dropped, before.leader, before.blocked_leader),
        np.where(dropped, hold, bar),
    )


def children(place: ElectionState, neighbour: NDArray[Any], valid: Bools) -> Bools:
    """Return which neighbours have the cell as their parent, ``(n, 4)``."""
    opposite = np.array(OPPOSITE)
    same = neighbour["leader"].astype(np.int64) == place.leader[:, None]
    farther = neighbour["hops"].astype(np.int64) > place.hops[:, None]
    return valid & same & farther & (neighbour["parent"] == opposite) & (place.leader != NOBODY)[:, None]
