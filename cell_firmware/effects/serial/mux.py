"""Line multiplexer: a switch that connects one SCI to four lines in turn."""

from __future__ import annotations

from typing import Final, final

import numpy as np

from cell_firmware.effects.serial.timing import Ints
from cell_firmware.firmware import Bools, Cells, State

PLACE: Final = ("periods", "since_ns")
"""What of its state is the switch's own, which no reset of the processor touches."""


@final
class LineMultiplexer:
    """Leads the lines of one SCI to one side at a time, by a count of the cell's own periods that is kept in hardware.

    Cells with an even sum of row and column go round north, east, south, west; the others south, west, north, east:
    neighbours whose counts agree face each other, each pair for one of four dwells.

    Args:
        dwell_periods: How long it stays on a side.
    """

    def __init__(self, dwell_periods: int) -> None:
        self._dwell = dwell_periods

    def init(self, cells: Cells) -> State:
        """Before the first period."""
        return {
            "periods": np.zeros(len(cells), dtype=np.int64),
            "ahead": 2 * ((cells.row + cells.column) % 2),
            "since_ns": np.zeros(len(cells), dtype=np.int64),
        }

    def selected(self, state: State) -> tuple[Bools, Ints]:
        """``(n, 4)``: the side whose bytes got through since the last step; ``(n, 1)``: since when they have, ns."""
        return self._selected(state, state["periods"] - 1), state["since_ns"][:, None]

    def advance(self, at_ns: Ints, state: State) -> tuple[State, Ints]:
        """The next period begins.

        Args:
            at_ns: ``(n, 1)`` or ``(1,)``, when.
            state: Of n cells.

        Returns:
            The next state, and ``(n, 4)``: for how many periods the switch stays, this one counted; 0 on other sides.
        """
        period = state["periods"]
        into = period % self._dwell
        since = np.where(into == 0, np.broadcast_to(at_ns.reshape(-1), period.shape), state["since_ns"])
        left = np.where(self._selected(state, period), (self._dwell - into)[:, None], 0)
        return {**state, "periods": period + 1, "since_ns": since}, left

    def _selected(self, state: State, period: Ints) -> Bools:
        side = (period // self._dwell + state["ahead"]) % 4
        return side[:, None] == np.arange(4)
