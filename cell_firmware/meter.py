"""Counts the messages that a cell's program sends and hears, for whoever wants to know what a protocol takes."""

from __future__ import annotations

from typing import final

import numpy as np

from cell_firmware.firmware import Cells, Inbox, Outbox, State
from cell_firmware.parts import Part


@final
class MessageMeter(Part):
    """Of each cell the messages that its program gave to a line with a neighbour at its end, and those it was given.

    Whole messages, whatever carries them: what lines replace, lose or delay was sent and is not heard, or later. The
    counts are the observer's: no reset touches them.
    """

    def init(self, cells: Cells) -> State:
        """None yet."""
        return {name: np.zeros(len(cells), dtype=np.int64) for name in ("sent", "heard")}

    def after_reset(self, cells: Cells, state: State) -> State:
        """As before."""
        del cells
        return state

    def count(self, state: State, cells: Cells, inbox: Inbox | None, outbox: Outbox | None) -> State:
        """The counts after a control period.

        Args:
            state: Before it.
            cells: Who.
            inbox: What their programs were given; None for firmware without messages.
            outbox: What they said; None for nothing at all.
        """
        sent, heard = state["sent"], state["heard"]
        if inbox is not None:
            heard = heard + inbox.received.sum(axis=1)
        if outbox is not None:
            sent = sent + (outbox.sent & cells.has_neighbour).sum(axis=1)
        return {"sent": sent, "heard": heard}

    def registers(self, state: State) -> dict[str, np.ndarray[tuple[int], np.dtype[np.int64]]]:
        """The counts of each cell."""
        return {name: state[name] for name in ("sent", "heard")}

    def counted(self, state: State) -> dict[str, int]:
        """The counts of all of them."""
        return {name: int(state[name].sum()) for name in ("sent", "heard")}
