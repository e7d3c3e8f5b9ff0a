"""A cell's board: its program, and the parts between the program and the pins."""

from __future__ import annotations

import traceback
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.components import BoardComponent, LinkDriver, MessageCounter, WheelDriver
from cell_firmware.controller import Controller, ControllerOutputs, ControllerState, StepTime, read_only
from cell_firmware.errors import FirmwareError, FirmwareFailed, NeverReturned
from cell_firmware.firmware import (
    Cells,
    Firmware,
    Floats,
    Inputs,
    Outbox,
    Outputs,
    State,
    can_settle,
    drafting,
)
from cell_firmware.message_drafts import array_draft
from cell_firmware.message_tracer import TRACE, MessageTracer
from cell_firmware.program_step import ProgramStep, step_one_by_one
from cell_firmware.random_draws import CellStreams
from cell_firmware.refusals import REFUSALS
from cell_firmware.scalar import ScalarFirmware, state_problem
from cell_firmware.stepping import NOW

PROGRAM = "firmware"
WHEELS = "speed_loop"
LINKS = "serial"
METER = "messages"


def has_hardware(controller: Controller) -> bool:
    """Whether a controller has a clock, a watchdog, speed loops or lines, beside the program and counters."""
    return not isinstance(controller, Board) or controller.wheels is not None or controller.links is not None


def has_kernels(controller: Controller) -> bool:
    """Whether there is something to compile: hardware, or a program in scalar form that exchanges messages."""
    if has_hardware(controller):
        return True
    assert isinstance(controller, Board), "this is a bug: no hardware, and no board"
    return isinstance(controller.firmware, ScalarFirmware) and controller.firmware.message is not None


class _BadOutput(Exception):
    """Firmware returned something of the wrong kind; no row in particular is to blame."""


@final
class Board(Controller):
    """Firmware and the parts of a board, composed into one pure step.

    Without parts the board is behavioural: links deliver whole messages, drives are speeds.

    Errors of firmware are not propagated: failed cells are listed in the outputs' ``failures``. For array firmware,
    which can't name the failing cell, the tick is stepped again cell by cell from the state before it: the cells that
    fail alone have failed, and the others get their normal results.

    Args:
        firmware: The cells' program.
        wheels: Given exactly where the wheels have motors.
        links: Driver of the links; None where links deliver whole messages.
        meter: Counter of messages; None: messages are not counted.
        tracer: Record of messages; None: messages are not traced.
        seed: Seed of the program's random numbers, the scene's.

    Attributes:
        parts: The parts by name.
        streams: Random numbers of the program; None for a program that declares none.
    """

    def __init__(
        self,
        firmware: Firmware,
        wheels: WheelDriver | None = None,
        links: LinkDriver | None = None,
        meter: MessageCounter | None = None,
        tracer: MessageTracer | None = None,
        seed: int = 0,
    ) -> None:
        self.firmware = firmware
        self.seed = seed
        self.streams = CellStreams(firmware.random, seed) if firmware.random else None
        self.wheels = wheels
        self.links = links
        self.meter = meter
        self.tracer = tracer
        parts: dict[str, BoardComponent | None] = {WHEELS: wheels, LINKS: links, METER: meter, TRACE: tracer}
        self.parts = {name: part for name, part in parts.items() if part is not None}
        message = None if firmware.refuses_misfits else firmware.message
        draft = None if message is None else array_draft(message)
        self._draft = None if draft == message else draft

    @property
    def link_type(self) -> np.dtype[Any] | None:
        """Type of a link's payload in a tick: a message of the firmware, or data of the serial lines."""
        return self.firmware.message if self.links is None else self.links.line

    @property
    def message_type(self) -> np.dtype[Any] | None:
        """A message of the firmware's."""
        return self.firmware.message

    @property
    def speculative(self) -> bool:
        """Whether the firmware may be stepped speculatively; the parts of a board are pure."""
        return self.firmware.speculative

    def passes_on(self, state: ControllerState) -> bool:
        """Whether a step leaves the parts of wrappers as they are: messages are not refused."""
        return REFUSALS not in state.parts

    def init(self, cells: Cells) -> ControllerState:
        """The state before tick 0.

        Raises:
            FirmwareFailed: The firmware's ``init`` raised, or made no arrays with a row per cell.
        """
        given = self._at_start(cells)
        program = self._begun(cells, "init", lambda rows: self.firmware.init(given.select(rows)))
        parts = {name: read_only(part.init(cells)) for name, part in self.parts.items()}
        return ControllerState(cells, {PROGRAM: program, **parts})

    def _at_start(self, cells: Cells) -> Cells:
        """Return the cells as the program's ``init`` is given them."""
        if self.streams is None:
            return cells
        return replace(cells, random=self.streams.at_start(cells.row, cells.column))

    def _begun(self, cells: Cells, what: str, make: Callable[[NDArray[np.int64]], Any]) -> State:
        """The program's state before its first step, of the cells of these rows together.

        Raises:
            FirmwareFailed: As ``init``; names the first cell that fails alone.
        """
        n = len(cells)
        try:
            program = read_only(_checked_state(make(np.arange(n)), None, n))
            _check_observed(self.firmware, program)
            _check_fields(self.firmware, program)
        except BaseException as error:  # noqa: BLE001 - whatever firmware raises becomes a named failure
            problem, trace = _described(error)
        else:
            return program
        if n > 1:
            for i in range(n):
                row = np.array([i])
                self._begun(cells.select(row), what, lambda _, row=row: make(row))
        raise FirmwareFailed(cells.name(0), 0, f"{what}: {problem}", trace)

    def idle(self, now: StepTime, state: ControllerState) -> ControllerState:
        """Advance every part by a control period in which the program does not run."""
        after = {name: read_only(part.idle(now, state.parts[name])) for name, part in self.parts.items()}
        return ControllerState(state.cells, {**state.parts, **after})

    def reset(self, state: ControllerState, *, warm: bool = False) -> ControllerState:
        """Reset the program, as after power-on or by its ``warm_start``, and every part by its own ``reset``."""
        cells, memory = state.cells, state.parts[PROGRAM]
        given = self._at_start(cells)

        def make(rows: NDArray[np.int64]) -> State:
            if not warm:
                return self.firmware.init(given.select(rows))
            return self.firmware.warm_start(
                given.select(rows), {name: array[rows] for name, array in memory.items()}
            )

        program = self._begun(cells, "warm_start" if warm else "init", make)
        retained = {
            name: read_only(part.reset(state.cells, state.parts[name])) for name, part in self.parts.items()
        }
        return ControllerState(cells, {PROGRAM: program, **retained})

    def receive(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, Inputs]:
        """Receive whole messages from the lines."""
        if self.links is None or inputs.inbox is None:
            return state, inputs
        lines, inbox = self.links.receive(now, state.parts[LINKS], inputs.inbox)
        return ControllerState(state.cells, {**state.parts, LINKS: lines}), replace(inputs, inbox=inbox)

    def compute(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """One control period."""
        parts = dict(state.parts)
        if self.streams is not None:
            inputs = inputs.with_random(self.streams.of_tick(now.tick, state.cells.row, state.cells.column))
        done = self.step_program(now.tick, state.cells, parts[PROGRAM], inputs)
        parts[PROGRAM] = read_only(done.state)
        drive, outbox = done.speed_m_s, done.outbox
        if self.wheels is not None:
            if inputs.encoder_m is None:
                raise FirmwareError("this is a bug: a speed loop without encoders")
            parts[WHEELS], drive = self.wheels.step(parts[WHEELS], drive, inputs.encoder_m)
        if done.failures:
            rows = list(done.failures)
            drive = drive.copy()
            drive[rows] = 0.0
            if outbox is not None:
                sent = outbox.sent.copy()
                sent[rows] = False
                outbox = Outbox(sent, outbox.message)
        if self.meter is not None:
            received, sent = inputs.inbox and inputs.inbox.received, outbox and outbox.sent
            parts[METER] = read_only(self.meter.count(parts[METER], state.cells, received, sent))
        if self.tracer is not None:
            parts[TRACE] = read_only(self.tracer.keep(now.tick, parts[TRACE], inputs.inbox, outbox))
        if self.links is not None:
            parts[LINKS], outbox = self.links.send(now, parts[LINKS], outbox)
        return ControllerState(state.cells, parts), ControllerOutputs(
            drive, outbox, done.failures, done.served
        )

    def registers(self, state: ControllerState) -> dict[str, NDArray[Any]]:
        """Return the program's variables and the registers of all parts."""
        return {
            **{
                f"{PROGRAM}.{name}": array
                for name, array in self.firmware.observables(state.parts[PROGRAM]).items()
            },
            **{
                f"{part.effect or name}.{register}": value
                for name, part in self.parts.items()
                for register, value in part.registers(state.parts[name]).items()
            },
        }

    def counters(self, state: ControllerState) -> dict[str, int]:
        """Return the counters of all parts, by ``part.counter``."""
        return {
            f"{part.effect or name}.{what}": number
            for name, part in self.parts.items()
            for what, number in part.counters(state.parts[name]).items()
        }

    def step_program(self, tick: int, cells: Cells, before: State, inputs: Inputs) -> ProgramStep:
        """Step the firmware, all cells at once; if that fails, each cell alone.

        Args:
            tick: Of the failures.
            cells: The cells.
            before: Their programs' state.
            inputs: Their inputs.
        """
        n = len(cells)
        NOW.tick, NOW.row, NOW.column, NOW.index = tick, cells.row, cells.column, -1
        if NOW.observe is not None:
            NOW.observe(tick, cells.row, cells.column, self.firmware, before, inputs)
        checked: tuple[State, Outputs] | None = None
        problem, trace, hung = "", "", False
        try:
            with drafting(self.firmware, self._draft):
                result = self.firmware.step(before, inputs)
            NOW.row = None
            checked = _checked(result, before, self.firmware.message, n)
        except BaseException as error:  # noqa: BLE001 - whatever firmware raises becomes a named failure
            NOW.row = None
            (problem, trace), hung = _described(error), isinstance(error, NeverReturned)
        if checked is None:  # past the handler: tracebacks of cells stepped alone would begin with this one
            failed = {i: FirmwareFailed(cells.name(i), tick, problem, trace) for i in range(n)}
            together = ProgramStep(before, np.zeros((n, 2)), None, failed)
            if n == 1:
                return together
            message = self.firmware.message
            return step_one_by_one(
                self.step_program, message, tick, cells, before, inputs, together, hung=hung
            )
        state, outputs = checked
        speed, failures = _speeds(tick, cells, outputs)
        outbox, message = outputs.outbox, self.firmware.message
        if outbox is not None and message is not None and not self.firmware.refuses_misfits:
            outbox, misfits = outbox.settled(message)
            for i, problem in misfits.items():
                failures.setdefault(i, FirmwareFailed(cells.name(i), tick, problem))
        return ProgramStep(state, speed, outbox, failures, outputs.served)


def _speeds(tick: int, cells: Cells, outputs: Outputs) -> tuple[Floats, dict[int, FirmwareFailed]]:
    """Return the firmware's speeds, zero where not finite, and the failures reported by firmware or found here."""
    failures = {
        i: FirmwareFailed(cells.name(i), tick, _last_line(text), text if "\n" in text else "")
        for i, text in (outputs.failed or {}).items()
    }
    speed = np.asarray(outputs.speed_m_s, dtype=np.float64)
    finite = np.isfinite(speed)
    if not finite.all():
        for i in np.flatnonzero(~finite.all(axis=1)).tolist():
            problem = f"drive is not finite: speed {outputs.speed_m_s[i].tolist()} m/s"
            failures.setdefault(i, FirmwareFailed(cells.name(i), tick, problem))
        speed = np.where(finite, speed, 0.0)
    return speed, failures


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
    served: Any = outputs.served
    if served is not None and not _is_flags(served, (n,)):
        raise _BadOutput(f"served must be None or bool of shape ({n},), not {_kind(served)}")
    return _checked_state(state, before, n), outputs


def _check_outbox(outbox: Any, message: np.dtype[Any] | None, n: int) -> None:
    if message is None:
        raise _BadOutput("the firmware sends messages but declares no message type")
    if not isinstance(outbox, Outbox):
        raise _BadOutput(f"outbox must be an Outbox, not {type(outbox).__name__}")
    sent: Any = outbox.sent
    if not _is_flags(sent, (n, 4)):
        raise _BadOutput(f"outbox.sent must be bool of shape ({n}, 4), not {_kind(sent)}")
    found: Any = outbox.message
    if not isinstance(found, np.ndarray) or found.shape != (n, 4) or not can_settle(found.dtype, message):  # pyright: ignore[reportUnknownMemberType, reportUnknownArgumentType]
        raise _BadOutput(f"outbox.message must be {message} of shape ({n}, 4), not {_kind(found)}")


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


def _check_observed(firmware: Firmware, state: State) -> None:
    name = firmware.observable
    if name is not None and name not in (found := firmware.observables(state)):
        raise _BadOutput(
            f"observable is {name!r}: the state has no such variable; it has {', '.join(found) or 'none'}"
        )


def _check_fields(firmware: Firmware, state: State) -> None:
    if isinstance(firmware, ScalarFirmware) and (
        problem := state_problem(firmware.scalar_kernels().STATE, state)
    ):
        raise _BadOutput(problem)


def _is_flags(value: Any, shape: tuple[int, ...]) -> bool:
    return isinstance(value, np.ndarray) and value.dtype == np.bool_ and value.shape == shape  # pyright: ignore[reportUnknownMemberType, reportUnknownVariableType]


def _kind(value: Any) -> str:
    if isinstance(value, np.ndarray):
        array: NDArray[Any] = value  # pyright: ignore[reportUnknownVariableType]
        return f"{array.dtype} of shape {array.shape}"
    return type(value).__name__


def _described(error: BaseException) -> tuple[str, str]:
    """The problem in a line, and the traceback where firmware raised."""
    if isinstance(error, _BadOutput):
        return str(error), ""
    trace = "".join(traceback.format_exception(error))
    return _last_line(trace), trace


def _last_line(trace: str) -> str:
    return trace.strip().splitlines()[-1]
