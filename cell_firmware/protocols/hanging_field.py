"""A velocity field with a bug, to see what a watchdog is for: on some cells the program hangs after a while."""

from __future__ import annotations

from typing import Annotated, final

import numpy as np
from pydantic import Field

from bus.lattice import Lattice
from cell_firmware.errors import ParametersError, Problem
from cell_firmware.fields import FieldSpec
from cell_firmware.firmware import Cells, Firmware, Floats, Inputs, Outputs, State
from cell_firmware.specs import CellName, Spec


class HangingFieldParameters(Spec):
    """The field, and the cells that hang after a number of periods."""

    field: FieldSpec
    cells: tuple[CellName, ...]
    """Cells whose program hangs."""
    after_periods: Annotated[int, Field(ge=1, le=1_000_000_000)]
    """Number of control periods from each start of the program until it hangs."""


@final
class HangingField(Firmware):
    """Velocity field whose program raises on some cells after a number of periods, when a counter runs over."""

    Parameters = HangingFieldParameters

    def check(self, lattice: Lattice) -> None:
        """Every cell that is named must exist."""
        problems = tuple(
            Problem(("cells", i), f"the array has no cell [{cell[0]}, {cell[1]}]", list(cell))
            for i, cell in enumerate(self.parameters.cells)
            if cell not in lattice
        )
        if problems:
            raise ParametersError("hanging_field", problems)

    def check_geometry(self, lattice: Lattice, position_m: Floats, pitch_m: float) -> None:
        """The field must be a number at every cell."""
        del pitch_m
        self.parameters.field.check_places("hanging_field", lattice, position_m)

    def init(self, cells: Cells) -> State:
        """Each cell's speed, ``(n, 2)`` m/s, and the periods left, ``(n,)``; negative without the bug."""
        x, y = cells.position_m[:, 0], cells.position_m[:, 1]
        left = np.full(len(cells), -1, dtype=np.int64)
        for row, column in self.parameters.cells:
            left[(cells.row == row) & (cells.column == column)] = self.parameters.after_periods
        return {"speed_m_s": self.parameters.field.velocity(x, y), "left": left}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        """Drive the field's velocity; raise once the counter of periods has run over."""
        del inputs
        left = state["left"]
        if (left == 0).any():
            raise OverflowError("the counter of periods has run over")
        return {**state, "left": np.where(left > 0, left - 1, left)}, Outputs(state["speed_m_s"])
