"""Programs whose first cell, in one tick, sends a marked number and drives at a marked speed."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State

TICK: Final = 3
"""Tick in which the numbers are marked."""
SPEED_M_S: Final = 0.12345678901234567
VALUE: Final = 0.7654321098765432


class Plain(CellFirmware):
    """The program in plain Python."""

    message = np.dtype([("value", "<f8")])

    def init(self, cell: Cell) -> dict[str, Any]:
        return {"tick": 0, "column": cell.column}

    def step(self, state: dict[str, Any], inputs: CellInputs) -> tuple[dict[str, Any], CellOutputs]:
        marked = state["tick"] == TICK and state["column"] == 0
        speed, value = (SPEED_M_S, VALUE) if marked else (0.0, 0.0)
        outbox = {side: {"value": value} for side in inputs.inbox}
        return {**state, "tick": state["tick"] + 1}, CellOutputs((speed, 0.0), outbox)


class OnArrays(Firmware):
    """The program on arrays."""

    message = np.dtype([("value", "<f8")])

    def init(self, cells: Cells) -> State:
        return {"tick": np.zeros(len(cells), dtype=np.int64), "column": cells.column.copy()}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        marked = (state["tick"] == TICK) & (state["column"] == 0)
        speed = np.where(marked[:, None], [SPEED_M_S, 0.0], 0.0)
        outbox = Outbox.to_all(self.message, value=np.where(marked, VALUE, 0.0))
        return {**state, "tick": state["tick"] + 1}, Outputs(speed, outbox)
