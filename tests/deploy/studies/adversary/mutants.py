"""Protocols that are right, and mutants of them with the mistakes that slipped through seeded runs."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import Any, ClassVar, NamedTuple

import numpy as np

from cell_firmware.firmware import Inputs, Outputs, State
from cell_firmware.protocols.average_consensus import AverageConsensus
from mdms import SIDES, ArrayView, Cell, CellFirmware, CellInputs, CellOutputs

HALF = 1 << 15
MASK = 0xFFFF


# --- versions that wrap ---------------------------------------------------------------------------


class Word(NamedTuple):
    """Newest word that a cell knows; whether the cell is its source, and for how many periods it has stood there."""

    source: bool
    version: int = 0
    value: int = 0
    age: int = 0


class SerialWords(CellFirmware):
    """The south-western cell changes its word every fourth period; the others repeat the newest that they know.

    Versions are serial numbers of 16 bits (RFC 1982), as those of the tiles of ``route``.
    """

    message = np.dtype([("version", "<u2"), ("value", "u1")])
    counters: ClassVar = {"version": 1 << 16}

    @staticmethod
    def newer(version: int, than: int) -> bool:
        return 0 < (version - than & MASK) < HALF

    def init(self, cell: Cell) -> Word:
        return Word(cell.row == cell.column == 0)

    def step(self, state: Word, inputs: CellInputs) -> tuple[Word, CellOutputs]:
        version, value, age = state.version, state.value, state.age + 1
        if state.source:
            if age >= 4 and value < 3:
                version, value, age = version + 1 & MASK, value + 1, 0
        else:
            for word in inputs.inbox.values():
                if word is not None and self.newer(word["version"], version):
                    version, value = word["version"], word["value"]
            age = 0
        after = Word(state.source, version, value, min(age, 4))
        word = {"version": version, "value": value}
        return after, CellOutputs((0.0, 0.0), dict.fromkeys(SIDES, word))

    def eventually(self, view: ArrayView) -> Iterable[tuple[str, Any, int]]:
        source = np.flatnonzero(view["source"])
        if len(source):
            yield "all cells know the source's word", view["value"] == view["value"][source[0]], 8


class PlainWords(SerialWords):
    """Mutant: versions are compared as numbers, so that after a wrap no word is newer than an old one."""

    @staticmethod
    def newer(version: int, than: int) -> bool:
        return version > than


# --- averages ---------------------------------------------------------------------------------------


class Averaging(AverageConsensus):
    """``average_consensus`` with its condition."""

    def eventually(self, view: ArrayView) -> Iterable[tuple[str, Any, int]]:
        agrees = abs(view["value"].mean() - view["given"].mean()) < 1e-3
        yield "the mean is that of the given values", bool(agrees), 40


class AveragingWithoutFlows(Averaging):
    """Mutant: linear iterations as of Xiao and Boyd, without flows, so that a lost message changes the mean."""

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        assert inputs.inbox is not None
        message = inputs.inbox.message.copy()
        message["flow"] = 0.0
        bare = {**state, "given": state["value"], "flow": np.zeros_like(state["flow"])}
        after, outputs = super().step(bare, replace(inputs, inbox=replace(inputs.inbox, message=message)))
        return {**after, "given": state["given"]}, outputs


# --- a hand-over in two phases ----------------------------------------------------------------------


class Handing(NamedTuple):
    """State of a cell of a row along which a parcel's reservation is handed on, to the east."""

    last: bool
    holds: bool = False
    gives: bool = False
    taken: bool = False


class HandOver(CellFirmware):
    """A cell that holds offers the reservation to the east until that cell has acknowledged; then it is free."""

    message = np.dtype([("give", "?"), ("taken", "?")])
    waits: ClassVar[bool] = True

    def init(self, cell: Cell) -> Handing:
        return Handing("east" not in cell.neighbours, holds=cell.column == 0)

    def step(self, state: Handing, inputs: CellInputs) -> tuple[Handing, CellOutputs]:
        west, east = inputs.inbox["west"], inputs.inbox["east"]
        holds, gives, taken = state.holds, state.gives, state.taken
        if west is not None and west["give"] and not taken:
            holds, taken = True, True
        if gives and (not self.waits or (east is not None and east["taken"])):
            gives = False
        if holds and not state.last and state.holds:
            holds, gives = False, True
        after = Handing(state.last, holds, gives, taken)
        outbox = {"east": {"give": gives, "taken": False}, "west": {"give": False, "taken": taken}}
        return after, CellOutputs((0.0, 0.0), outbox)

    def invariants(self, view: ArrayView) -> Iterable[tuple[str, Any]]:
        yield "a parcel is in one reservation at most", bool(view["holds"].sum() <= 1)

    def eventually(self, view: ArrayView) -> Iterable[tuple[str, Any, int]]:
        yield "a cell has the reservation", bool(view["holds"].sum() + view["gives"].sum() >= 1), 6


class HandOverUnacknowledged(HandOver):
    """Mutant: the offer is made once, and no acknowledgement is waited for."""

    waits = False


# --- a spanning tree --------------------------------------------------------------------------------


class Branch(NamedTuple):
    """Root that a cell follows, its distance, and the cell's own number."""

    own: int
    root: int
    distance: int


LIMIT = 9


class Tree(CellFirmware):
    """Cells follow the least number in reach, at bounded distance: what no root renews counts up to the bound."""

    message = np.dtype([("root", "u1"), ("distance", "u1")])

    def init(self, cell: Cell) -> Branch:
        own = 16 * cell.row + cell.column
        return Branch(own, own, 0)

    def step(self, state: Branch, inputs: CellInputs) -> tuple[Branch, CellOutputs]:
        heard = [
            (word["root"], word["distance"] + 1)
            for word in inputs.inbox.values()
            if word is not None and word["distance"] + 1 < LIMIT
        ]
        root, distance = min([(state.own, 0), *self.kept(state), *heard])
        word = {"root": root, "distance": distance}
        return Branch(state.own, root, distance), CellOutputs((0.0, 0.0), dict.fromkeys(SIDES, word))

    def kept(self, state: Branch) -> list[tuple[int, int]]:
        return []

    def eventually(self, view: ArrayView) -> Iterable[tuple[str, Any, int]]:
        yield "the root of each cell is alive", np.isin(view["root"], view["own"]), 2 * LIMIT


class TreeOfTheDead(Tree):
    """Mutant: a cell keeps the best root that it has ever heard of."""

    def kept(self, state: Branch) -> list[tuple[int, int]]:
        return [(state.root, state.distance)]


class NearTree(CellFirmware):
    """The tree without eventual conditions: distances are bounded."""

    message = Tree.message
    init = Tree.init
    step = Tree.step  # pyright: ignore[reportAssignmentType]
    kept = Tree.kept

    def invariants(self, view: ArrayView) -> Iterable[tuple[str, Any]]:
        yield "distances are bounded", view["distance"] < LIMIT


class Wave(CellFirmware):
    """The same program for every cell: a cell is as far along as the slowest that it hears, and one more."""

    message = np.dtype([("phase", "u1")])

    def init(self, cell: Cell) -> dict[str, int]:
        return {"phase": 0, "heard": 0}

    def step(self, state: dict[str, int], inputs: CellInputs) -> tuple[dict[str, int], CellOutputs]:
        words = [word["phase"] for word in inputs.inbox.values() if word is not None]
        phase = (min([state["phase"], *words]) + 1) % 6 if words else state["phase"]
        after = {"phase": phase, "heard": len(words)}
        return after, CellOutputs((0.0, 0.0), {side: {"phase": phase} for side in SIDES})

    def invariants(self, view: ArrayView) -> Iterable[tuple[str, Any]]:
        yield "phases are numbers below 6", view["phase"] < 6


class Corner(Wave):
    """A condition that is broken at one corner alone: symmetric states differ in it."""

    def invariants(self, view: ArrayView) -> Iterable[tuple[str, Any]]:
        if (1, 1) in view.cells:
            yield (
                "the cell in the corner hears both neighbours",
                bool(view["phase"][view.index((1, 1))] == 0 or view["heard"][view.index((1, 1))] == 2),
            )
