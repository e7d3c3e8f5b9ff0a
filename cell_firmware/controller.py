"""Interface of a cell's controller: pins and received bytes in, pins and sent bytes out."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar, Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.errors import FirmwareFailed
from cell_firmware.firmware import Bools, Cells, Floats, Inputs, Outbox, State, put_rows, take_rows

_MOST: Final = 0.75
"""Of the cells: if more of them are stepped, it costs less to step all."""


class StepTime(NamedTuple):
    """Step times of n cells.

    Attributes:
        tick: Number of the exchange with the plant; of the window where cells have their own clocks.
        at_ns: ``(n,)`` int64, simulated time at which each cell reads its pins, ``clocks.NOT_IN_WINDOW`` for one that
            is not stepped in this exchange; ``()`` where it is one for all.
    """

    tick: int
    at_ns: NDArray[np.int64]

    def select(self, rows: NDArray[np.int64]) -> StepTime:
        """Select the instants of ``rows``, in order."""
        return self if self.at_ns.ndim == 0 else StepTime(self.tick, self.at_ns[rows])


@final
@dataclass(frozen=True, slots=True)
class ControllerState:
    """Complete state of n cells: everything that a step depends on, apart from its inputs.

    Attributes:
        cells: The cells.
        parts: By name of the controller's part, arrays by name, each with a row a cell.
    """

    cells: Cells
    parts: Mapping[str, State]

    def select(self, rows: NDArray[np.int64]) -> ControllerState:
        """Select the state of ``rows``, in order."""
        return ControllerState(
            self.cells.select(rows),
            {
                part: {name: take_rows(array, rows) for name, array in state.items()}
                for part, state in self.parts.items()
            },
        )

    def replace_rows(self, rows: NDArray[np.int64], other: ControllerState) -> ControllerState:
        """Return this state with ``rows`` replaced by the rows of ``other``, in order."""
        parts: dict[str, State] = {}
        for part, state in self.parts.items():
            changed: dict[str, NDArray[Any]] = {}
            for name, array in state.items():
                theirs = other.parts[part][name]
                # a program may have gone over from one type to another
                changed[name] = array.astype(np.result_type(array, theirs), order="C")
                put_rows(changed[name], rows, theirs)
            parts[part] = read_only(changed)
        return ControllerState(self.cells, parts)

    def rollback_rows(self, rows: NDArray[np.int64], before: ControllerState) -> ControllerState:
        """Return this state with ``rows`` restored from ``before``.

        Arrays that only this state has are written to: for what a step has just made, and few rows.
        """
        taken = {id(array) for state in before.parts.values() for array in state.values()}
        parts: dict[str, State] = {}
        for part, state in self.parts.items():
            merged: dict[str, NDArray[Any]] = {}
            for name, array in state.items():
                old = before.parts[part][name]
                if array is old:
                    merged[name] = array
                    continue
                if array.base is not None or id(array) in taken or array.dtype != old.dtype:
                    array = array.astype(np.result_type(array, old), order="C")  # noqa: PLW2901 - a copy
                taken.add(id(array))
                array.setflags(write=True)
                put_rows(array, rows, take_rows(old, rows))
                merged[name] = array
            parts[part] = read_only(merged)
        return ControllerState(self.cells, parts)

    @staticmethod
    def concatenate(cells: Cells, states: Sequence[ControllerState]) -> ControllerState:
        """Concatenate the states of single cells into the state of ``per_cell``."""
        first = states[0].parts
        return ControllerState(
            cells,
            {
                part: read_only(
                    {name: np.concatenate([s.parts[part][name] for s in states]) for name in state}
                )
                for part, state in first.items()
            },
        )


@final
@dataclass(frozen=True, slots=True)
class ControllerOutputs:
    """Outputs of n cells in a tick.

    Attributes:
        drive: ``(n, 2)`` float64, volts where there are motors, else surface speed, m/s. Zero for failed cells.
        outbox: Payloads of the links; None without messages. Failed cells send nothing.
        failures: Failures by index of the cell; empty if there are none.
        served: ``(n,)``, whether the program served its watchdog; None: all did.
        hung: By index of the cell, the failure after which the program hangs; the cell is not lost.
    """

    drive: Floats
    outbox: Outbox | None
    failures: Mapping[int, FirmwareFailed] = field(default_factory=dict[int, FirmwareFailed])
    served: Bools | None = None
    hung: Mapping[int, FirmwareFailed] = field(default_factory=dict[int, FirmwareFailed])


class Controller(ABC):
    """Controllers of n cells: a pure step, with the same bytes for one cell and for thousands.

    Every emulation of a cell implements this interface: a program in floating point, a board with its timers and serial
    lines, an instruction set. All variables are in the state; the controller defines which of them a reset clears.
    """

    @property
    @abstractmethod
    def link_type(self) -> np.dtype[Any] | None:
        """Little-endian structured type of what a link carries in a tick; None if cells don't talk."""

    @property
    def message_type(self) -> np.dtype[Any] | None:
        """Type of the programs' messages, which may differ from the type of a link's payload."""
        return self.link_type

    @property
    def general(self) -> Controller:
        """The controller to which faults can be attached: itself, but for a compiled one."""
        return self

    def passes_on(self, state: ControllerState) -> bool:  # noqa: ARG002
        """Whether a step leaves the parts of faults' wrappers in a state as they are, but for refused messages."""
        return False

    @property
    def speculative(self) -> bool:
        """Whether ``step`` may be run speculatively: cells that are not due are stepped too, and rolled back."""
        return False

    @abstractmethod
    def init(self, cells: Cells) -> ControllerState:
        """The state before tick 0, as after power-on.

        Raises:
            FirmwareFailed: A cell's program does not begin; names the cell.
        """

    def reset(self, state: ControllerState, *, warm: bool = False) -> ControllerState:  # noqa: ARG002
        """The state after a reset: by default as after power-on.

        Args:
            state: Before it, of the cells that are reset.
            warm: Whether the memory has retained its power, as in a watchdog's reset.

        Raises:
            FirmwareFailed: A cell's program does not begin; names the cell.
        """
        return self.init(state.cells)

    def receive(
        self,
        now: StepTime,  # noqa: ARG002
        state: ControllerState,
        inputs: Inputs,
    ) -> tuple[ControllerState, Inputs]:
        """Receive from the lines: once an exchange, also for cells that are not stepped.

        Args:
            now: When.
            state: Of the n cells.
            inputs: Readings of pins and links.

        Returns:
            The next state, and the inputs of the cells that are stepped.
        """
        return state, inputs

    @abstractmethod
    def compute(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """One control period.

        Args:
            now: When.
            state: Of the n cells.
            inputs: Inputs of the cells, from ``receive``.

        Returns:
            The next state and what the cells do. The state of a cell that failed means nothing.
        """

    def idle(self, now: StepTime, state: ControllerState) -> ControllerState:  # noqa: ARG002
        """Advance the hardware by a control period in which no program runs; by default nothing changes.

        Args:
            now: When.
            state: Of these cells.
        """
        return state

    def compute_rows(
        self, rows: NDArray[np.int64], now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """Compute a control period of ``rows``; other cells keep their state and have no outputs.

        Args:
            rows: Rows of the cells to compute, ascending.
            now: Step times of all n cells.
            state: State of all n cells.
            inputs: Inputs of all n cells, from ``receive``.

        Returns:
            The next state and the outputs of all n cells; drives are zero outside ``rows``.
        """
        n = len(state.cells)
        if len(rows) == n:
            return self.compute(now, state, inputs)
        drive = np.zeros((n, 2))
        if not len(rows):
            return state, ControllerOutputs(drive, None)
        if self.speculative and len(rows) > _MOST * n:
            return self._compute_most_rows(rows, now, state, inputs)
        some, outputs = self.compute(now.select(rows), state.select(rows), inputs.select(rows))
        put_rows(drive, rows, outputs.drive)
        outbox, served = None, None
        if outputs.outbox is not None:
            outbox = Outbox.empty(n, outputs.outbox.message.dtype)
            put_rows(outbox.sent, rows, outputs.outbox.sent)
            put_rows(outbox.message, rows, outputs.outbox.message)
        if outputs.served is not None:
            served = np.zeros(n, dtype=np.bool_)
            served[rows] = outputs.served
        failures, hung = (
            {int(rows[i]): failure for i, failure in found.items()}
            for found in (outputs.failures, outputs.hung)
        )
        return state.replace_rows(rows, some), ControllerOutputs(drive, outbox, failures, served, hung)

    def _compute_most_rows(
        self, rows: NDArray[np.int64], now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """Compute all cells, which is pure, and roll back the few that are not in ``rows``."""
        idle = np.ones(len(state.cells), dtype=np.bool_)
        idle[rows] = False
        others = np.flatnonzero(idle)
        after, outputs = self.compute(now, state, inputs)
        drive, outbox = outputs.drive.copy(), outputs.outbox
        drive[others] = 0.0
        if outbox is not None:
            outbox = Outbox(outbox.sent & ~idle[:, None], outbox.message)
        failures, hung = (
            {i: failure for i, failure in found.items() if not idle[i]}
            for found in (outputs.failures, outputs.hung)
        )
        served = None if outputs.served is None else outputs.served & ~idle
        return after.rollback_rows(others, state), ControllerOutputs(drive, outbox, failures, served, hung)

    def registers(self, state: ControllerState) -> dict[str, NDArray[Any]]:  # noqa: ARG002
        """Return the readable registers of the cells: ``part.register`` to an array with a row a cell."""
        return {}

    def counters(self, state: ControllerState) -> dict[str, int]:  # noqa: ARG002
        """Return the counters of events so far: ``part.counter`` to a number."""
        return {}


def read_only(state: State) -> State:
    """The state with its arrays read-only: a step that writes to its arguments is not pure, and fails."""
    for array in state.values():
        array.setflags(write=False)
    return state


class ControllerWrapper(Controller):
    """Base of wrappers that decide when the wrapped controller is stepped, and change its outputs.

    Args:
        controller: The cells' own.
    """

    part: ClassVar[str]
    """Name of the wrapper's part of the state, and prefix of its registers."""
    shown: ClassVar[tuple[str, ...]]
    """Arrays of that part that are registers."""

    def __init__(self, controller: Controller) -> None:
        self.controller = controller

    @property
    def link_type(self) -> np.dtype[Any] | None:
        """Type of a link's payload in a tick."""
        return self.controller.link_type

    @property
    def message_type(self) -> np.dtype[Any] | None:
        """Type of the programs' messages."""
        return self.controller.message_type

    @property
    def speculative(self) -> bool:
        """Whether the wrapped controller may be stepped speculatively."""
        return self.controller.speculative

    def unwrap_state(self, state: ControllerState) -> ControllerState:
        """Return the state of the wrapped controller."""
        parts = {name: part for name, part in state.parts.items() if name != self.part}
        return ControllerState(state.cells, parts)

    def wrap_state(self, inner: ControllerState, own: State) -> ControllerState:
        """Combine the wrapped controller's state and the wrapper's own, of the same cells."""
        return ControllerState(inner.cells, {**inner.parts, self.part: read_only(own)})

    def idle(self, now: StepTime, state: ControllerState) -> ControllerState:
        """Advance the wrapped controller by a control period in which no program runs."""
        return self.wrap_state(self.controller.idle(now, self.unwrap_state(state)), state.parts[self.part])

    def registers(self, state: ControllerState) -> dict[str, NDArray[Any]]:
        """Return the wrapper's own registers and the registers of the wrapped controller."""
        own = state.parts[self.part]
        shown = {f"{self.part}.{name}": own[name] for name in self.shown}
        return {**shown, **self.controller.registers(self.unwrap_state(state))}

    def counters(self, state: ControllerState) -> dict[str, int]:
        """Return the counters of the wrapped controller."""
        return self.controller.counters(self.unwrap_state(state))
