"""One control period of n cells: the firmware, and the speed loop where there are motors."""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.errors import FirmwareError, FirmwareFailed
from cell_firmware.firmware import Bools, Cells, Firmware, Floats, Inputs, Outbox, Outputs, State
from cell_firmware.speed_loop import SpeedLoop, SpeedLoopState


@final
@dataclass(frozen=True, slots=True)
class ControllerState:
    """Everything that a step of n cells depends on, apart from its inputs.

    Attributes:
        cells: Who they are.
        firmware: The firmware's state.
        speed_loop: The speed loop's; None without one.
    """

    cells: Cells
    firmware: State
    speed_loop: SpeedLoopState | None

    def take(self, indices: NDArray[np.int64]) -> ControllerState:
        """The state of these cells alone, in this order."""
        return ControllerState(
            self.cells.take(indices),
            {name: array[indices] for name, array in self.firmware.items()},
            self.speed_loop and self.speed_loop.take(indices),
        )


@final
@dataclass(frozen=True, slots=True)
class ControllerOutputs:
    """What n cells do in a tick.

    Attributes:
        drive: ``(n, 2)`` float64: volts with a speed loop, else surface speed in m/s. Zero where failed.
        outbox: Messages; None for firmware that has none, or sends nothing. Nothing sent where failed.
        failures: By index of the cell, what went wrong; empty if all is well.
    """

    drive: Floats
    outbox: Outbox | None
    failures: Mapping[int, FirmwareFailed]


class _BadOutput(Exception):
    """Firmware returned something of the wrong kind; no row in particular is to blame."""


@final
class Controller:
    """Composes firmware and speed loop into one pure step.

    Firmware that raises never raises through here: its cells are named in the outputs' ``failures``. For
    array firmware, which can't say which cell was the cause, the tick is stepped again cell by cell from the
    state before it; the cells that fail alone are the culprits, and the others get what they would have got.

    Args:
        firmware: The cells' program.
        speed_loop: Given exactly where the wheels have motors.
    """

    def __init__(self, firmware: Firmware, speed_loop: SpeedLoop | None = None) -> None:
        self.firmware = firmware
        self.speed_loop = speed_loop

    def init(self, cells: Cells) -> ControllerState:
        """The state before tick 0.

        Raises:
            FirmwareFailed: The firmware's ``init`` raised, or made no arrays with a row per cell.
        """
        n = len(cells)
        try:
            state = _frozen(_checked_state(self.firmware.init(cells), None, n))
        except Exception as error:  # noqa: BLE001 - whatever firmware raises becomes a named failure
            problem, trace = _described(error)
        else:
            return ControllerState(cells, state, self.speed_loop and self.speed_loop.init(n))
        if n > 1:  # find the first cell that fails alone
            for i in range(n):
                self.init(cells.take(np.array([i])))
        raise FirmwareFailed(cells.name(0), 0, f"init: {problem}", trace)

    def step(
        self, tick: int, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """One control period.

        Args:
            tick: Which; only to name it in failures.
            state: Of the n cells.
            inputs: Of the n cells.

        Returns:
            The next state and what the cells do. The state of a cell that failed means nothing.
        """
        n = len(state.cells)
        try:
            firmware, outputs = _checked(
                self.firmware.step(state.firmware, inputs), state.firmware, self.firmware.message, n
            )
        except Exception as error:  # noqa: BLE001 - whatever firmware raises becomes a named failure
            problem, trace = _described(error)
            if n == 1:
                failed = FirmwareFailed(state.cells.name(0), tick, problem, trace)
                return state, ControllerOutputs(np.zeros((1, 2)), None, {0: failed})
            return self._one_by_one(tick, state, inputs, f"{problem} (all {n} cells at once)", trace)
        return self._finish(tick, state, firmware, outputs, inputs)

    def _finish(
        self, tick: int, state: ControllerState, firmware: State, outputs: Outputs, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """Closes the speed loop and looks for rows that no drive or link can take."""
        speed, outbox = outputs.speed_m_s, outputs.outbox
        failures = {
            i: FirmwareFailed(state.cells.name(i), tick, _last_line(trace), trace)
            for i, trace in (outputs.failed or {}).items()
        }
        drive, loop = np.asarray(speed, dtype=np.float64), None
        finite = np.isfinite(drive)
        if not finite.all():
            for i in np.flatnonzero(~finite.all(axis=1)).tolist():
                problem = f"drive is not finite: speed {speed[i].tolist()} m/s"
                failures.setdefault(i, FirmwareFailed(state.cells.name(i), tick, problem))
            drive = np.where(finite, drive, 0.0)
        if self.speed_loop is not None:
            if inputs.encoder_m is None or state.speed_loop is None:
                raise FirmwareError("this is a bug: a speed loop without encoders")
            loop, drive = self.speed_loop.step(state.speed_loop, drive, inputs.encoder_m)
        if outbox is not None:
            for i, problem in _not_finite(outbox):
                failures.setdefault(i, FirmwareFailed(state.cells.name(i), tick, problem))
        if failures:
            rows = list(failures)
            drive = drive.copy()
            drive[rows] = 0.0
            if outbox is not None:
                sent = outbox.sent.copy()
                sent[rows] = False
                outbox = Outbox(sent, outbox.message)
        return (
            ControllerState(state.cells, _frozen(firmware), loop),
            ControllerOutputs(drive, outbox, failures),
        )

    def _one_by_one(
        self, tick: int, state: ControllerState, inputs: Inputs, problem: str, trace: str
    ) -> tuple[ControllerState, ControllerOutputs]:
        """Steps every cell alone, to tell those that fail from those that don't."""
        n = len(state.cells)
        states: list[ControllerState] = []
        drive = np.zeros((n, 2))
        message = self.firmware.message
        outbox = None if message is None else Outbox.empty(n, message)
        failures: dict[int, FirmwareFailed] = {}
        for i in range(n):
            alone = np.array([i])
            after, outputs = self.step(tick, state.take(alone), inputs.take(alone))
            states.append(after)
            drive[i] = outputs.drive[0]
            if outbox is not None and outputs.outbox is not None:
                outbox.sent[i] = outputs.outbox.sent[0]
                outbox.message[i] = outputs.outbox.message[0]
            if outputs.failures:
                failures[i] = outputs.failures[0]
        if not failures:  # it fails on many and on no one alone: none of them can be trusted
            failures = {i: FirmwareFailed(state.cells.name(i), tick, problem, trace) for i in range(n)}
            return state, ControllerOutputs(np.zeros((n, 2)), None, failures)
        return _joined(state.cells, states), ControllerOutputs(drive, outbox, failures)


def _joined(cells: Cells, states: list[ControllerState]) -> ControllerState:
    firmware = {
        name: np.concatenate([state.firmware[name] for state in states]) for name in states[0].firmware
    }
    loops = [state.speed_loop for state in states if state.speed_loop is not None]
    loop = None
    if loops:
        loop = SpeedLoopState(
            np.concatenate([loop.integral_v for loop in loops]),
            np.concatenate([loop.encoder_m for loop in loops]),
            np.concatenate([loop.seen for loop in loops]),
        )
    return ControllerState(cells, _frozen(firmware), loop)


def _frozen(state: State) -> State:
    """The state with its arrays read-only: a step that writes to its arguments is not pure, and fails."""
    for array in state.values():
        array.setflags(write=False)
    return state


def _checked(result: Any, before: State, message: np.dtype[Any] | None, n: int) -> tuple[State, Outputs]:
    """The result of a firmware's step, if it is of the right kind."""
    if not (isinstance(result, tuple) and len(result) == 2):  # pyright: ignore[reportUnknownArgumentType]
        raise _BadOutput(f"step must return (state, Outputs), not {type(result).__name__}")  # pyright: ignore[reportUnknownArgumentType]
    state, outputs = result  # pyright: ignore[reportUnknownVariableType]
    if not isinstance(outputs, Outputs):
        raise _BadOutput(f"step must return (state, Outputs), not {type(outputs).__name__} as the second")  # pyright: ignore[reportUnknownArgumentType]
    speed: Any = outputs.speed_m_s
    if not isinstance(speed, np.ndarray) or speed.shape != (n, 2) or speed.dtype.kind not in "fiu":  # pyright: ignore[reportUnknownMemberType]
        raise _BadOutput(f"speed_m_s must be real numbers of shape ({n}, 2), not {_kind(speed)}")
    if outputs.outbox is not None:
        _check_outbox(outputs.outbox, message, n)
    return _checked_state(state, before, n), outputs


def _check_outbox(outbox: Any, message: np.dtype[Any] | None, n: int) -> None:
    if message is None:
        raise _BadOutput("the firmware sends messages but declares no message type")
    if not isinstance(outbox, Outbox):
        raise _BadOutput(f"outbox must be an Outbox, not {type(outbox).__name__}")
    for name, array, dtype in (
        ("sent", outbox.sent, np.dtype(np.bool_)),
        ("message", outbox.message, message),
    ):
        found: Any = array
        if not isinstance(found, np.ndarray) or found.shape != (n, 4) or found.dtype != dtype:  # pyright: ignore[reportUnknownMemberType]
            raise _BadOutput(f"outbox.{name} must be {dtype} of shape ({n}, 4), not {_kind(found)}")


def _checked_state(state: Any, before: State | None, n: int) -> State:
    if not isinstance(state, Mapping):
        raise _BadOutput(f"state must be a mapping of names to arrays, not {type(state).__name__}")
    if before is not None and state.keys() != before.keys():  # pyright: ignore[reportUnknownMemberType]
        raise _BadOutput(f"state must hold {sorted(before)} as before, not {sorted(state)}")  # pyright: ignore[reportUnknownArgumentType]
    arrays: Mapping[str, Any] = state  # pyright: ignore[reportUnknownVariableType]
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray) or array.ndim < 1 or len(array) != n:  # pyright: ignore[reportUnknownArgumentType]
            raise _BadOutput(
                f"state[{name!r}] must be an array with {n} rows, one a cell, not {_kind(array)}"
            )
    return arrays


def _kind(value: Any) -> str:
    if isinstance(value, np.ndarray):
        array: NDArray[Any] = value  # pyright: ignore[reportUnknownVariableType]
        return f"{array.dtype} of shape {array.shape}"
    return type(value).__name__


def _not_finite(outbox: Outbox) -> list[tuple[int, str]]:
    """Cells that send a message with a float in it that is none, and the field's name."""
    found: list[tuple[int, str]] = []
    for name in outbox.message.dtype.names or ():
        values = outbox.message[name]
        if values.dtype.kind != "f":
            continue
        finite: Bools = np.isfinite(values)
        if finite.all():
            continue
        bad: Bools = outbox.sent & ~finite.reshape(*finite.shape[:2], -1).all(axis=2)
        found += [
            (i, f"message field {name} is not finite") for i in np.flatnonzero(bad.any(axis=1)).tolist()
        ]
    return found


def _described(error: Exception) -> tuple[str, str]:
    """The problem in a line, and the traceback where firmware raised."""
    if isinstance(error, _BadOutput):
        return str(error), ""
    trace = "".join(traceback.format_exception(error))
    return _last_line(trace), trace


def _last_line(trace: str) -> str:
    return trace.strip().splitlines()[-1]
