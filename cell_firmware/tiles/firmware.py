"""Base of protocols on tiles that reserve a path before carrying a parcel: ``reserve_path`` and ``route``."""

from __future__ import annotations

from abc import abstractmethod
from typing import Annotated, Any, ClassVar, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from bus.lattice import STEPS, Lattice
from cell_firmware.errors import ParametersError
from cell_firmware.firmware import Bools, Cells, Firmware, Floats, Inputs, Outbox, Outputs, State
from cell_firmware.program import Theory
from cell_firmware.specs import NotNegative, Positive
from cell_firmware.tiles import heartbeat as rounds
from cell_firmware.tiles.leader import NeighbourTiles, decide, doubtful, refused
from cell_firmware.tiles.messages import (
    MASK_16,
    NEIGHBOURS,
    OPPOSITES,
    TALK,
    TileMode,
    doing,
    exit_of,
    is_word,
    newest_words,
    resumed,
    side,
    version,
    word,
)
from cell_firmware.tiles.tiling import TilesSpec, Tiling
from cell_firmware.toolkit.graph import hop_distance
from cell_firmware.toolkit.hold import Ttl, age_ttl, hold_last

Ints = NDArray[np.int64]

_AHEAD: Final = np.array([(column, row) for row, column in STEPS], dtype=np.float64)
_AFRESH: Final = 16
"""Versions that a new leader skips, as the dead leader may have sent newer words than the last one received."""


class TileParameters(TilesSpec):
    """Tiles and lanes, motion of parcels, and time-outs."""

    speed_m_s: Positive = 0.5
    """Speed of parcels that move to the next tile, and largest speed of parcels that are centred."""
    gain_per_s: tuple[Positive, Positive] = (5.0, 4.0)
    """Rates, along x and y, of the elliptic field that centres a parcel in a tile."""
    settle_s: NotNegative = 0.3
    """Time for which a parcel is centred before it changes direction."""
    least_cells: Annotated[int, Field(ge=1)] | None = None
    """Least number of live cells of an open tile, more than half of its cells. Default: all but one row."""
    waiting_hops: Annotated[int, Field(ge=0, le=1_000)] = 4
    """Additional distance, in cells, of a tile whose parcel waits, so that other parcels take shorter detours."""
    ttl_periods: Annotated[int, Field(ge=8, le=255)] = 40
    """Validity of a tile's word, ticks: longer than its propagation through two tiles."""
    recall: Ttl = 4
    """Validity of a neighbour's distances, periods."""
    limit: Annotated[int, Field(ge=2, le=16_000)] = 250
    """Distance, in cells, that stands for no route."""

    @model_validator(mode="after")
    def _one_leader(self) -> TileParameters:
        cells = self.tile_cells * self.tile_cells
        if self.least_cells is not None and not cells < 2 * self.least_cells <= 2 * cells:
            rule = f"must be more than half of a tile's {cells} cells and at most all"
            raise ValueError(f"least_cells {rule}, not {self.least_cells}: halves could follow two leaders")
        return self


class TileFirmware(Firmware):
    """See ``docs/protocols/routing.md``."""

    Parameters = TileParameters
    name: ClassVar[str]
    """As scenes name it."""
    message = np.dtype([*TALK, ("way_1", "<u2")])
    observable = "distance"

    def __init__(self, parameters: TileParameters) -> None:
        super().__init__(parameters)
        self.tiling = Tiling(parameters)
        self._kinds = self.kinds(parameters)
        self.ways = [f"way_{number}" for number in range(1, self._kinds + 1)]
        self.message = np.dtype([*TALK, *((way, "<u2") for way in self.ways)])  # pyright: ignore[reportIncompatibleVariableOverride, reportAttributeAccessIssue]

    @staticmethod
    @abstractmethod
    def kinds(parameters: TileParameters) -> int:
        """Return the number of kinds of exits that parcels distinguish."""

    @abstractmethod
    def labels(self, inputs: Inputs) -> Ints:
        """Return the kind of exit of the parcel over each cell, ``(n,)``; 0 where unknown."""

    def check(self, lattice: Lattice) -> None:
        """Every cell of every tile must exist."""
        problems = tuple(self.tiling.problems(lattice))
        if problems:
            raise ParametersError(self.name, problems)

    def accepts(self, messages: NDArray[Any]) -> Bools:
        """Return which messages are plausible: valid words, with known modes and exits."""
        good = super().accepts(messages)
        for name in ("own", *NEIGHBOURS):
            words = messages[name].astype(np.int64)
            good &= is_word(words) & (doing(words) <= TileMode.PUSH) & (exit_of(words) <= self._kinds)
        return good & (messages["label"] <= self._kinds)

    def theory(self, lattice: Lattice) -> Theory:
        """Cells' distances along the lanes, by exit; known one tick a cell from each, once its tile is open."""
        cells = Cells.of(lattice, np.zeros((len(lattice), 2)), 1.0)
        place = self.tiling.place(cells)
        passes = place["mate"] | place["out"]
        kind = np.minimum(place["exit"], self._kinds)
        away = [
            hop_distance(lattice, np.flatnonzero(kind == number), passes)
            for number in range(1, self._kinds + 1)
        ]
        far, limit = np.stack(away, axis=1), self.parameters.limit
        return Theory(
            "a cell knows its distance d along the lanes d ticks after the tiles on the way are open",
            limit=np.where((far < 0) | (far > limit), limit, far),
        )

    def init(self, cells: Cells) -> State:
        """Return the initial state: place in the tile, words of tiles, distances, rounds, and leader's state."""
        place, n, sides = self.tiling.place(cells), len(cells), (len(cells), 4)
        silence = np.full(
            n, -self.parameters.ttl_periods
        )  # a cell that starts first listens whether somebody leads
        place["exit"] = np.minimum(place["exit"], self._kinds)
        least = self.parameters.least_cells or self.tiling.side * (self.tiling.side - 1)
        far = self.parameters.limit << 2
        return {
            **place,
            **rounds.initial_state(place, self.tiling.side),
            "silence": silence,
            "own": np.zeros(n, dtype=np.int64),
            "last": np.zeros(n, dtype=np.int64),
            "around": np.zeros(sides, dtype=np.int64),
            "least": np.full(n, least),
            "held": np.zeros(n, dtype=np.int64),
            "came": np.full(n, 4),
            "turn": np.full(n, 3),
            "here": np.zeros(n, dtype=np.bool_),
            "passed": np.zeros(n, dtype=np.bool_),
            "grace": np.full(n, -1),
            "neighbour": np.full((*sides, self._kinds), far, dtype=np.uint16),
            "counts": np.zeros(sides, dtype=np.int16),
            "way": np.full((n, self._kinds), far),
            "distance": np.full((n, self._kinds), self.parameters.limit),
            "settle": np.full(n, round(self.parameters.settle_s / cells.period_s)),
        }

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Receive, update the ways, decide as a leader, drive, and send."""
        inbox, ttl_periods = inputs.inbox, self.parameters.ttl_periods
        assert inbox is not None, "this is a bug: this firmware has messages"
        own, around = newest_words(state["own"], state["around"], inbox, state["mate"], state["used"])
        here, passed = _under_its_parcel(state, inputs, own)
        label = np.where(here, self.labels(inputs), 0)
        neighbour, counts = self._update_neighbours(state, inputs)
        way = self._ways(state, neighbour)
        after, leads, takes_over = rounds.on_messages(state, inbox, here, label, ttl_periods)
        known = NeighbourTiles.of(around)
        own = self._lead(state, after, own, known, way, leads, takes_over, here, label)
        speed = np.where(passed[:, None], 0.0, self._speed(state, own, known))
        after["here"], after["passed"] = here, passed
        outbox = self._send(state, after, own, around, way)
        del after["ended"]
        learnt = {
            "own": own,
            "around": around,
            "neighbour": neighbour,
            "counts": counts,
            "way": way,
            "distance": way >> 2,
        }
        return {**state, **after, **learnt}, Outputs(speed, outbox)

    def _update_neighbours(
        self, state: State, inputs: Inputs
    ) -> tuple[NDArray[np.uint16], NDArray[np.int16]]:
        inbox = inputs.inbox
        assert inbox is not None
        counts = age_ttl(inbox.received, state["counts"], self.parameters.recall)
        received = np.stack([inbox.message[way] for way in self.ways], axis=2)
        return hold_last(
            inbox.received, counts, received, state["neighbour"], silence=self.parameters.limit << 2
        ), counts

    def _ways(self, state: State, neighbour: NDArray[np.uint16]) -> Ints:
        """Return the ways, ``(n, kinds)``: four times the distance, plus the side over which to leave the tile."""
        far, hops = self.parameters.limit << 2, neighbour.astype(np.int64)
        out, mate = state["out"][:, :, None], state["mate"][:, :, None]
        away = (hops & ~3) + 4 | np.arange(4)[:, None]
        ahead = np.where(mate, hops + 4, np.where(out, away, far))
        best = np.minimum(ahead.min(axis=1), far)
        there = state["exit"][:, None] == np.arange(1, self._kinds + 1)
        return np.where(there, state["exit_side"][:, None], best)

    def _lead(
        self,
        state: State,
        after: dict[str, NDArray[Any]],
        own: Ints,
        around: NeighbourTiles,
        way: Ints,
        leads: Bools,
        takes_over: Bools,
        here: Bools,
        label: Ints,
    ) -> Ints:
        """Return the new word of the own tile where a cell leads; adds the leader's state to ``after``."""
        last = np.where(own > 0, own, state["last"])
        after["last"] = last
        leaving = state["exit"] == exit_of(last)
        own = np.where(takes_over, resumed(last, leaving, _AFRESH), own)
        over = rounds.round_finished(state, after, leads)
        after["sure"] = np.where(takes_over, 0, after["sure"])
        full = after["sure"] > state["sure"]
        doubts = leads & doubtful(state, own, around)
        after["grace"] = np.where(doubts, np.where(state["grace"] < 0, 0, state["grace"] + full), -1)
        after["ended"], after["least"] = over, state["least"]
        decision = decide(state, after, own, around, way, self.parameters.limit)
        was, now = doing(own) * 4 + side(own), decision.code
        changed = leads & (
            (now != was) | (decision.exit != own >> 16 & 255) | (decision.ticket != own & MASK_16)
        )
        word_ = word(version(own) + changed, self.parameters.ttl_periods, now, decision.exit, decision.ticket)
        expects, has = TileMode.EXPECT, now >> 2 >= TileMode.HOLD
        got = changed & (was >> 2 < TileMode.HOLD) & has
        after["came"] = np.where(got, np.where(was >> 2 == expects, was & 3, 4), state["came"])
        after["held"] = np.where(has & ~got, np.minimum(state["held"] + 1, state["settle"]), 0)
        granted = changed & (now >> 2 == expects)
        after["turn"] = np.where(granted, now & 3, state["turn"])
        after["sure"] = np.where(changed, 0, after["sure"])
        fresh_doubt = doubts & (state["grace"] < 0)
        rounds.start_round(state, after, over | changed | fresh_doubt, here, label)
        return np.where(leads, word_, own)

    def _speed(self, state: State, own: Ints, around: NeighbourTiles) -> Floats:
        """Centre the parcel where a tile has or expects one; drive at full speed over the side to pass it on.

        Where the receiving tile has closed, the parcel is pulled back at once; the leader determines later who has it.
        """
        most = self.parameters.speed_m_s
        does = doing(own)
        centring = np.clip(-np.array(self.parameters.gain_per_s) * state["offset_m"], -most, most)
        ahead = _AHEAD[side(own)]
        pushing = np.where(ahead != 0.0, most * ahead, centring)
        yields = does == TileMode.YIELD
        carries = ((does >= TileMode.EXPECT) & ~yields)[:, None]
        taken = yields & (around.on(side(own)).doing >= TileMode.HOLD)
        pushes = (does == TileMode.PUSH) & ~refused(state, own, around) | taken
        return np.where(pushes[:, None], pushing, np.where(carries, centring, 0.0))

    def _send(
        self, state: State, after: dict[str, NDArray[Any]], own: Ints, around: Ints, way: Ints
    ) -> Outbox:
        n = len(own)
        message = np.zeros((n, 4), dtype=self.message)
        for name in ("pulse", "alive", "covered", "label", "passed"):
            message[name] = after[name][:, None]
        message["own"] = own[:, None]
        for number, name in enumerate(NEIGHBOURS):
            message[name] = around[:, number, None]
        does = doing(own)
        passes = (does != TileMode.CLOSED) & (does != TileMode.HOLD)
        far = self.parameters.limit << 2
        toll = np.where(does == TileMode.WANT, self.parameters.waiting_hops << 2, 0)
        for number, name in enumerate(self.ways):
            known = way[:, number]
            shown = np.where(passes, np.minimum(known + toll, far), far)
            message[name] = np.where(state["mate"], known[:, None], shown[:, None])
        return Outbox(np.repeat(state["used"][:, None], 4, axis=1), message)


def _under_its_parcel(state: State, inputs: Inputs, own: Ints) -> tuple[Bools, Bools]:
    """Return which cells are under their tile's parcel, and which the leaving parcel has passed.

    Passed cells stop, and attribute later readings to the next parcel, which may follow directly. While a tile has no
    word, as its leader is dead, the last word counts: the next leader continues from it.
    """
    inbox = inputs.inbox
    assert inbox is not None
    sensed, own = np.asarray(inputs.presence.any(axis=1)), np.where(own > 0, own, state["last"])
    passed_by_mates = inbox.message["passed"] & state["mate"] & (side(own)[:, None] != OPPOSITES)
    gone = ~sensed & (state["here"] | passed_by_mates.any(axis=1))
    leaves = (doing(own) == TileMode.PUSH) | (doing(own) == TileMode.YIELD)
    passed = leaves & (state["passed"] | gone)
    return sensed & ~passed, passed
