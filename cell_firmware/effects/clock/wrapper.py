"""Local clocks: each cell is stepped at its own instants, and holds its outputs in between."""

from __future__ import annotations

from collections.abc import Mapping
from typing import final

import numpy as np

from cell_firmware.clocks import NOT_IN_WINDOW, ArrayClocks, CellClocks
from cell_firmware.controller import (
    Controller,
    ControllerOutputs,
    ControllerState,
    ControllerWrapper,
    StepTime,
)
from cell_firmware.errors import FirmwareFailed
from cell_firmware.firmware import Cells, Inputs


@final
class LocalClockWrapper(ControllerWrapper):
    """Wrapper that steps each cell at the instants of its own clock.

    Exchange k brings what each cell with an instant r in window k - 1 read at r: those cells are stepped, each with its
    own r, and the others are not. What a cell computed at r acts from r + W on, W being the window, until what it
    computes next does. See ``cell_firmware.clocks``.

    Args:
        controller: Controller of the cells.
        clocks: Clocks of the whole array.
    """

    part = "clock"
    shown = ("ppb", "count")

    def __init__(self, controller: Controller, clocks: ArrayClocks) -> None:
        super().__init__(controller)
        self._clocks = clocks

    @property
    def clocks(self) -> ArrayClocks:
        """Clocks of the whole array."""
        return self._clocks

    def init(self, cells: Cells) -> ControllerState:
        """Return the state before a cell's first instant, with wheels at rest."""
        inner = self.controller.init(cells)
        clocks = self._clocks.of(cells.row, cells.column)
        clock = {
            "ppb": clocks.ppb,
            "phase_ns": clocks.phase_ns,
            "count": np.zeros(len(cells), dtype=np.int64),
            "drive": np.zeros((len(cells), 2)),
        }
        return self.wrap_state(inner, clock)

    def compute(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """Compute a control period of the cells with an instant in the previous window."""
        clock = state.parts[self.part]
        whole, window = self._clocks.clocks, now.tick - 1
        clocks = CellClocks(whole.period_ns, whole.window_ns, clock["ppb"], clock["phase_ns"])
        then = StepTime(window, clocks.due(window, clock["count"]))
        stepped = then.at_ns != NOT_IN_WINDOW
        inner, inputs = self.controller.receive(then, self.unwrap_state(state), inputs)
        inner, outputs = self.controller.compute_rows(np.flatnonzero(stepped), then, inner, inputs)
        drive = np.where(stepped[:, None], outputs.drive, clock["drive"])
        after = {**clock, "count": clock["count"] + stepped, "drive": drive}
        return (
            self.wrap_state(inner, after),
            ControllerOutputs(
                drive,
                outputs.outbox,
                in_tick(now.tick, outputs.failures),
                hung=in_tick(now.tick, outputs.hung),
            ),
        )


def in_tick(tick: int, failures: Mapping[int, FirmwareFailed]) -> dict[int, FirmwareFailed]:
    """Return the failures, dated by the exchange ``tick`` in which they came out."""
    return {i: FirmwareFailed(one.cell, tick, one.problem, one.trace) for i, one in failures.items()}
