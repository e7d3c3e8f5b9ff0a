"""Programs of the lab's tests, in a module that ``mdms run`` can import."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mdms import (
    SIDES,
    ArrayView,
    Cell,
    CellFirmware,
    CellInputs,
    CellOutputs,
    Cells,
    Firmware,
    Inputs,
    Outbox,
    Outputs,
    State,
)


@dataclass(frozen=True)
class Heard:
    """State of ``Gossip``: the greatest number heard of, the periods, and the covered ones."""

    most: int
    periods: int = 0
    covered: int = 0


class Gossip(CellFirmware):
    """Cells agree on the greatest number; at first everyone has its own, ``10 row + column``."""

    message = np.dtype([("most", "<i4")])

    def init(self, cell: Cell) -> Heard:
        return Heard(10 * cell.row + cell.column)

    def step(self, state: Heard, inputs: CellInputs) -> tuple[Heard, CellOutputs]:
        most = max([state.most, *(word["most"] for word in inputs.inbox.values() if word is not None)])
        after = Heard(most, state.periods + 1, state.covered + any(inputs.presence))
        return after, CellOutputs((0.01 * most, 0.0), {side: {"most": most} for side in SIDES})


class Counting(Gossip):
    """Gossip with conditions: the numbers are of cells, and all cells know the greatest after some ticks."""

    def invariants(self, view: ArrayView) -> Iterable[tuple[str, Any]]:
        yield "the number is a cell's", view["most"] % 10 < 10
        yield "the number never exceeds 12", view["most"] <= 12

    def eventually(self, view: ArrayView) -> Iterable[tuple[str, Any, int]]:
        yield "all cells know the same number", (view["most"] == view["most"].max()), 4


class Echo(Firmware):
    """On arrays: each cell sums what it hears, so that every lost, late or repeated message shows for ever."""

    message = np.dtype([("sum", "<i8")])

    def init(self, cells: Cells) -> State:
        return {"sum": cells.row * 7 + cells.column + 1, "seen": np.zeros(len(cells), dtype=np.int64)}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        assert inputs.inbox is not None
        heard = np.where(inputs.inbox.received, inputs.inbox.message["sum"], 0)
        total = state["sum"]
        for side in range(4):
            total = (3 * total + heard[:, side]) % 1_000_003
        seen = state["seen"] + inputs.presence[:, 0]
        talks = total % 3 > 0
        outbox = Outbox.to_all(self.message, sum=total)
        return {"sum": total, "seen": seen}, Outputs(
            np.stack((total * 1e-6, seen * 1e-3), axis=1),
            Outbox(outbox.sent & talks[:, None], outbox.message),
        )


class Fails(CellFirmware):
    """Cell 0,1 raises in its fourth period."""

    def init(self, cell: Cell) -> tuple[int, int]:
        return cell.column, 0

    def step(self, state: tuple[int, int], inputs: CellInputs) -> tuple[tuple[int, int], CellOutputs]:
        if state == (1, 3):
            raise ZeroDivisionError("on purpose")
        return (state[0], state[1] + 1), CellOutputs((0.0, 0.0))
