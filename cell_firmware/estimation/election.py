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
"""Side of the parent of a cell that leads, or follows nobody."""
FARTHEST: Final = 40
"""Hops from a leader beyond which nobody follows it: no loop lasts longer."""
FIELDS: Final = [("level", "u1"), ("leader", "<u4"), ("hops", "u1"), ("parent", "u1")]
"""What cells tell each other of it: 7 bytes."""


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


def levels(covered: Bools, told: NDArray[Any], heard: Bools, halo: int) -> Integers:
    """How near a sensed parcel is, counted down hop by hop."""
    theirs = np.where(heard, told["level"].astype(np.int64), 0)
    highest = np.maximum(np.maximum(theirs[:, 0], theirs[:, 1]), np.maximum(theirs[:, 2], theirs[:, 3]))
    return np.where(covered, halo + 1, np.maximum(highest, 1) - 1)


def elect(
    own: Integers,
    covered: Bools,
    level: Integers,
    told: NDArray[Any],
    heard: Bools,
    before: ElectionState,
    hold: int,
) -> ElectionState:
    """One round of the election: everybody follows the least key that it hears of, by the fewest links.

    Only cells that sense a parcel stand. Who follows a leader goes on following it only along neighbours that are no
    farther from it than itself, and does not listen to its name for a while after that fails: so when a leader is gone
    those that follow it drop it in a wave, one hop a period, instead of passing its name round among themselves
    (the feasibility condition of distance-vector routing: Garcia-Luna-Aceves, IEEE/ACM Trans. Networking 1, 1993).

    Args:
        own: ``(n,)`` keys of the cells.
        covered: ``(n,)``: does it sense a parcel?
        level: ``(n,)``, as ``levels`` has it.
        told: ``(n, 4)``, each neighbour's last word, with ``FIELDS``.
        heard: ``(n, 4)``: does that word still count?
        before: The round before.
        hold: Periods for which a leader that is gone is not listened to.
    """
    bar = np.maximum(before.block_ticks, 1) - 1
    best = np.where(covered, own, NOBODY) << 8
    parent = np.full(len(own), ROOT, dtype=np.int64)
    for side in range(4):
        leader, hops = told["leader"][:, side].astype(np.int64), told["hops"][:, side].astype(np.int64)
        stale = (leader == own) | ((bar > 0) & (leader == before.blocked_leader))
        circular = (leader == before.leader) & (hops > before.hops)
        fit = heard[:, side] & (leader != NOBODY) & (hops < FARTHEST) & ~stale & ~circular
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


def children(place: ElectionState, told: NDArray[Any], heard: Bools) -> Bools:
    """``(n, 4)``: which neighbours have the cell for their parent."""
    opposite = np.array(OPPOSITE)
    same = told["leader"].astype(np.int64) == place.leader[:, None]
    farther = told["hops"].astype(np.int64) > place.hops[:, None]
    return heard & same & farther & (told["parent"] == opposite) & (place.leader != NOBODY)[:, None]
