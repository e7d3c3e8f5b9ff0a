"""Parts of a cell's board between its pins and its program; each is pure, and remembers in arrays with a row a cell."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.controller import StepTime
from cell_firmware.firmware import Cells, Floats, Inbox, Outbox, State


class BoardComponent(ABC):
    """A part of the board, of n cells at once."""

    effect: ClassVar[str] = ""
    """The effect under whose name it is shown; its own name on the board where that is empty."""

    @abstractmethod
    def init(self, cells: Cells) -> State:
        """What it remembers after power-on: arrays by name, each with a row a cell."""

    def reset(self, cells: Cells, state: State) -> State:  # noqa: ARG002
        """What it remembers after a reset without loss of power: by default nothing, as after power-on.

        Args:
            cells: Who is reset.
            state: What it remembered before.
        """
        return self.init(cells)

    def idle(self, now: StepTime, state: State) -> State:  # noqa: ARG002
        """What it remembers after a control period in which the program did not run: by default the same.

        Args:
            now: When.
            state: Of n cells whose program hangs, or has not started yet.
        """
        return state

    def registers(self, state: State) -> dict[str, NDArray[Any]]:  # noqa: ARG002
        """What can be read of it: arrays by name, each with a row a cell."""
        return {}

    def counters(self, state: State) -> dict[str, int]:  # noqa: ARG002
        """What happened so far that is worth counting, by name."""
        return {}


class WheelDriver(BoardComponent):
    """What makes two wheels with motors follow a speed."""

    @abstractmethod
    def step(self, state: State, reference_m_s: Floats, encoder_m: Floats) -> tuple[State, Floats]:
        """One control period.

        Args:
            state: Of n cells.
            reference_m_s: ``(n, 2)``, wanted surface speed, m/s; finite.
            encoder_m: ``(n, 2)``, surface travel since the start, m: where the encoders' discs are.

        Returns:
            The next state, and ``(n, 2)`` motor voltages.
        """


class LinkDriver(BoardComponent):
    """What carries messages over lines that do less than to hand over whole messages.

    Attributes:
        line: Type of what a line carries in a tick.
    """

    line: np.dtype[Any]

    @abstractmethod
    def receive(self, now: StepTime, state: State, lines: Inbox) -> tuple[State, Inbox]:
        """What the program hears of what has come in: once an exchange, whether or not a cell is stepped in it.

        Args:
            now: When; a cell that is not stepped hears nothing yet.
            state: Of n cells.
            lines: What came in, ``(n, 4)`` of ``line``.

        Returns:
            The next state, and whole messages, ``(n, 4)`` of the program's type.
        """

    @abstractmethod
    def send(self, now: StepTime, state: State, outbox: Outbox | None) -> tuple[State, Outbox]:
        """What goes out of what the program says.

        Args:
            now: When.
            state: Of n cells.
            outbox: Messages, ``(n, 4)`` of the program's type; None for none at all.

        Returns:
            The next state, and ``(n, 4)`` of ``line``.
        """


@final
class MessageCounter(BoardComponent):
    """Of each cell the messages that its program gave to a line with a neighbour at its end, and those it was given.

    Whole messages, whatever carries them: what lines replace, lose or delay was sent and is not heard, or later. The
    counts are the observer's: no reset touches them.
    """

    def init(self, cells: Cells) -> State:
        """None yet."""
        return {name: np.zeros(len(cells), dtype=np.int64) for name in ("sent", "heard")}

    def reset(self, cells: Cells, state: State) -> State:
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

    def counters(self, state: State) -> dict[str, int]:
        """The counts of all of them."""
        return {name: int(state[name].sum()) for name in ("sent", "heard")}
