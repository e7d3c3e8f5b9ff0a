"""Board components between a cell's pins and its program: pure, with state in arrays of a row a cell."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.controller import StepTime
from cell_firmware.firmware import Bools, Cells, Floats, Inbox, Outbox, State


class BoardComponent(ABC):
    """A part of the board, of n cells at once."""

    effect: ClassVar[str] = ""
    """The effect under whose name it is shown; its own name on the board where that is empty."""

    @abstractmethod
    def init(self, cells: Cells) -> State:
        """Return the state after power-on: arrays by name, each with a row a cell."""

    def constants(self) -> NDArray[Any] | None:
        """Return its constants as a record of ``cell_firmware.kernels``; None: no kernel steps it."""
        return None

    def reset(self, cells: Cells, state: State) -> State:  # noqa: ARG002
        """Return the state after a reset without loss of power; by default as after power-on.

        Args:
            cells: The cells that are reset.
            state: State before the reset.
        """
        return self.init(cells)

    def idle(self, now: StepTime, state: State) -> State:  # noqa: ARG002
        """Return the state after a control period in which the program did not run; by default unchanged.

        Args:
            now: When.
            state: Of n cells whose program hangs, or has not started yet.
        """
        return state

    def registers(self, state: State) -> dict[str, NDArray[Any]]:  # noqa: ARG002
        """Return the readable registers: arrays by name, each with a row a cell."""
        return {}

    def counters(self, state: State) -> dict[str, int]:  # noqa: ARG002
        """Return the counters of events so far, by name."""
        return {}


class WheelDriver(BoardComponent):
    """Speed controller of two wheels with motors."""

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


@final
@dataclass(frozen=True, slots=True)
class LinkMemory:
    """State of n cells' links in memory of their own kernels.

    Attributes:
        parts: The same memory by name, as the driver has it.
        record: ``(1,)``, what the kernels are given the address of.
        arrays: Memory at the record's addresses.
        kernels: Addresses of the kernels, by their names in ``kernels.lines.LINES``.
    """

    parts: State
    record: NDArray[Any]
    arrays: tuple[NDArray[Any], ...]
    kernels: Mapping[str, int]


class LinkDriver(BoardComponent):
    """Driver of lines that can't transfer whole messages directly.

    Attributes:
        line: Type of what a line carries in a tick.
    """

    kernels: ClassVar[str] = ""
    """Module of the links' own kernels; empty: those of ``kernels.lines`` serve."""
    line: np.dtype[Any]

    def bind(self, state: State) -> LinkMemory | None:  # noqa: ARG002
        """Copy a state into memory of the links' own kernels; None: they have records of ``kernels.lines``."""
        return None

    @abstractmethod
    def receive(self, now: StepTime, state: State, lines: Inbox) -> tuple[State, Inbox]:
        """Return the messages that the program receives; called once an exchange, whether or not cells are stepped.

        Args:
            now: Step times; a cell that is not stepped receives nothing yet.
            state: Of n cells.
            lines: What came in, ``(n, 4)`` of ``line``.

        Returns:
            The next state, and whole messages, ``(n, 4)`` of the program's type.
        """

    @abstractmethod
    def send(self, now: StepTime, state: State, outbox: Outbox | None) -> tuple[State, Outbox]:
        """Encode the program's messages for the lines.

        Args:
            now: When.
            state: Of n cells.
            outbox: Messages, ``(n, 4)`` of the program's type; None for none at all.

        Returns:
            The next state, and ``(n, 4)`` of ``line``.
        """


@final
class MessageCounter(BoardComponent):
    """Counters of messages, by cell: sent to existing neighbours, and received.

    Whole messages are counted, whatever transfers them: a message that lines replace, lose or delay counts as sent, and
    as received if it arrives. The counters belong to the observer: a reset does not change them.
    """

    def init(self, cells: Cells) -> State:
        """Return zero counters."""
        return {name: np.zeros(len(cells), dtype=np.int64) for name in ("sent", "received")}

    def reset(self, cells: Cells, state: State) -> State:
        """Return the state unchanged."""
        del cells
        return state

    def count(self, state: State, cells: Cells, received: Bools | None, sent: Bools | None) -> State:
        """Return the counters after a control period.

        Args:
            state: State before the control period.
            cells: The cells.
            received: ``(n, 4)``, whether the program received a message on the side; None for firmware without
                messages.
            sent: ``(n, 4)``, whether the program sends a message on the side; None if there are none at all.
        """
        counts = dict(state)
        if received is not None:
            counts["received"] = counts["received"] + received.sum(axis=1)
        if sent is not None:
            counts["sent"] = counts["sent"] + (sent & cells.has_neighbour).sum(axis=1)
        return counts

    def registers(self, state: State) -> dict[str, np.ndarray[tuple[int], np.dtype[np.int64]]]:
        """Return the counters of each cell."""
        return {name: state[name] for name in ("sent", "received")}

    def counters(self, state: State) -> dict[str, int]:
        """Return the counters summed over all cells."""
        return {name: int(state[name].sum()) for name in ("sent", "received")}
