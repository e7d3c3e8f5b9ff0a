"""Decisions of a tile's leader: when to accept a parcel, and when and where to pass its own on.

Two tiles pass a parcel on in four steps, each repeated until the other tile has received it: A *wants*, B *expects*
(with a ticket that names the granted request), A *pushes*, and once no cell of A senses the parcel, A is free; B then
has the parcel. Words are repeated and their versions only grow, so that steps can be lost or late, but not mixed up.

Where A's leader dies while A pushes, its heir *yields*: B, whose request of A no longer stands, takes the parcel if its
cells sense it, else withdraws; only then A has the parcel, if A's cells sense it. A tile that takes a parcel back keeps
the version of the granted request as its ticket, by which an heir of B learns that B is not to take it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Bools
from cell_firmware.tiles.messages import MASK_16, OPPOSITES, TileMode, doing, exit_of, side, ticket, version

Ints = NDArray[np.int64]


@final
@dataclass(frozen=True, slots=True)
class NeighbourTiles:
    """Neighbouring tiles on the four sides, as known to a leader, ``(n, 4)`` each.

    Attributes:
        doing: Mode of each tile.
        faces: Whether the mode concerns the side towards this tile.
        exit: Exit of the tile's parcel.
        version: Version of the tile's word.
        ticket: Version of the request that the tile grants.
    """

    doing: Ints
    faces: Bools
    exit: Ints
    version: Ints
    ticket: Ints

    @staticmethod
    def of(words: Ints) -> NeighbourTiles:
        """Decode the words of the four tiles."""
        return NeighbourTiles(
            doing(words), side(words) == OPPOSITES, exit_of(words), version(words), ticket(words)
        )

    def on(self, sides: Ints) -> NeighbourTiles:
        """Select one side for each row, ``(n,)``."""
        row = np.arange(len(sides))
        return NeighbourTiles(
            self.doing[row, sides],
            self.faces[row, sides],
            self.exit[row, sides],
            self.version[row, sides],
            self.ticket[row, sides],
        )


@final
@dataclass(frozen=True, slots=True)
class Decision:
    """Next state of tiles, ``(n,)`` each: four times the mode plus the side, exit of the parcel, and ticket."""

    code: Ints
    exit: Ints
    ticket: Ints

    def where(self, condition: Bools, code: Ints, exit_: Ints, ticket_: Ints) -> Decision:
        """Replace the decision where a condition holds."""
        return Decision(
            np.where(condition, code, self.code),
            np.where(condition, exit_, self.exit),
            np.where(condition, ticket_, self.ticket),
        )


def with_parcel(state: Any, ways: Ints, limit: int, exit_: Ints) -> Ints:
    """Return mode and side of a tile with a parcel for an exit: push, request the way, or hold."""
    way = _way_to(ways, exit_[:, None])[:, 0]
    known = (exit_ > 0) & (way >> 2 < limit)
    onward = np.where(known, TileMode.WANT * 4 + (way & 3), TileMode.HOLD * 4)
    return np.where(known & (state["exit"] == exit_), TileMode.PUSH * 4 + state["exit_side"], onward)


def decide(
    state: Any, after: dict[str, NDArray[Any]], own: Ints, around: NeighbourTiles, ways: Ints, limit: int
) -> Decision:
    """Decide the next state of tiles.

    Args:
        state: State of the firmware.
        after: Results of rounds.
        own: ``(n,)``, the tile's current word.
        around: The neighbouring tiles.
        ways: ``(n, exits)``, four times the distance to each exit, plus the side over which the way leads.
        limit: Distance that means no way.
    """
    was, at, exit_, ticket_ = doing(own), side(own), exit_of(own), ticket(own)
    partner = around.on(at)
    sure, occupied, read = after["sure"] >= 1, after["occupied"], after["read"]
    entry = ~state["into"].any(axis=1)
    labelled = entry & sure & occupied & (read > 0)
    nothing = np.zeros_like(own)
    unchanged = Decision(was * 4 + at, exit_, ticket_)
    mine = with_parcel(state, ways, limit, exit_)
    decision = unchanged.where(
        labelled & (was <= TileMode.FREE), with_parcel(state, ways, limit, read), read, nothing
    )
    vacant = sure & ~occupied
    decision = decision.where(
        (was == TileMode.CLOSED) & vacant, nothing + TileMode.FREE * 4, nothing, nothing
    )
    decision = decision.where((was == TileMode.CLOSED) & sure & occupied & (exit_ > 0), mine, exit_, nothing)
    decision = _granted(decision, state, was == TileMode.FREE, vacant, around, ways, limit)

    lost = (was == TileMode.EXPECT) & (after["grace"] >= 1)
    takes = occupied & ~((partner.doing >= TileMode.HOLD) & (partner.ticket == ticket_))
    decision = decision.where(lost & takes, mine, exit_, nothing)
    decision = decision.where(lost & ~takes, nothing + TileMode.FREE * 4, nothing, nothing)

    yields = was == TileMode.YIELD
    awaits = (partner.doing == TileMode.EXPECT) & partner.faces & (partner.ticket == ticket_)
    left = ~awaits & (partner.doing < TileMode.HOLD)
    decision = decision.where(yields & vacant, nothing + TileMode.FREE * 4, nothing, nothing)
    decision = decision.where(yields & sure & occupied & left, mine, exit_, ticket_)

    decision = decision.where(
        (was == TileMode.HOLD) | (was == TileMode.WANT) & after["ended"], mine, exit_, ticket_
    )
    steady = (state["held"] >= state["settle"]) | (state["came"] == OPPOSITES[at])
    promised = (partner.doing == TileMode.EXPECT) & partner.faces & (partner.ticket == version(own))
    goes = (was == TileMode.WANT) & promised & steady
    decision = decision.where(goes, TileMode.PUSH * 4 + at, exit_, nothing)

    stopped = (was == TileMode.PUSH) & (after["grace"] >= 1) & occupied
    decision = decision.where(stopped, mine, exit_, version(own) - 1 & MASK_16)
    decision = decision.where((was == TileMode.PUSH) & vacant, nothing + TileMode.FREE * 4, nothing, nothing)

    open_ = np.bitwise_count(after["members"].astype(np.uint64)) >= after["least"]
    keeps = (was >= TileMode.YIELD) | (was == TileMode.CLOSED)
    return decision.where(~open_, nothing, np.where(keeps, exit_, 0), nothing)


def refused(state: Any, own: Ints, around: NeighbourTiles) -> Bools:
    """Return where the receiver of a pushed parcel has closed; a parcel that leaves by an exit can't be refused."""
    leaving = state["exit"] == exit_of(own)
    return (doing(own) == TileMode.PUSH) & ~leaving & (around.on(side(own)).doing == TileMode.CLOSED)


def doubtful(state: Any, own: Ints, around: NeighbourTiles) -> Bools:
    """Return where only a new round can show which tile has the parcel: the other has closed, or withdrawn."""
    partner, granted = around.on(side(own)), ticket(own)
    wants = (partner.doing == TileMode.WANT) & (partner.version == granted)
    pushes = (partner.doing == TileMode.PUSH) & (partner.version == (granted + 1 & MASK_16))
    waits_in_vain = (doing(own) == TileMode.EXPECT) & ~(partner.faces & (wants | pushes))
    return waits_in_vain | refused(state, own, around)


def _granted(
    decision: Decision, state: Any, free: Bools, vacant: Bools, around: NeighbourTiles, ways: Ints, limit: int
) -> Decision:
    """Grant a request to a free tile: a neighbour that already pushes first, else the sides in turn."""
    ours = around.faces & state["into"]
    pushes = ours & (around.doing == TileMode.PUSH)
    leads_on = (around.exit > 0) & (_way_to(ways, around.exit) >> 2 < limit)
    asks = ours & (around.doing == TileMode.WANT) & leads_on & vacant[:, None]
    late = (np.arange(4) - state["turn"][:, None] - 1) % 4
    first = np.where(pushes, late - 8, np.where(asks, late, 9)).argmin(axis=1)
    chosen = around.on(first)
    found = free & (pushes | asks).any(axis=1)
    wish = np.where(chosen.doing == TileMode.PUSH, chosen.version - 1, chosen.version) & MASK_16
    return decision.where(found, TileMode.EXPECT * 4 + first, chosen.exit, wish)


def _way_to(ways: Ints, exits: Ints) -> Ints:
    """``(n, k)`` ways to the exits ``(n, k)``, numbered from 1; for 0 whichever is first."""
    return np.take_along_axis(ways, np.maximum(exits, 1) - 1, axis=1)
