"""Compiled controller: the board of every cell in two calls a control period, before and after the programs' step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.wire.message_type import check_message
from cell_firmware.board import LINKS, METER, PROGRAM, WHEELS, Board, has_kernels
from cell_firmware.components import LinkMemory
from cell_firmware.controller import Controller, ControllerOutputs, ControllerState, StepTime
from cell_firmware.effects.clock.wrapper import LocalClockWrapper, in_tick
from cell_firmware.effects.cop.wrapper import DIVIDER_NS, WatchdogWrapper
from cell_firmware.firmware import Bools, Cells, Firmware, Inbox, Inputs, Messages, Outbox, State
from cell_firmware.kernels import board as kernels
from cell_firmware.kernels.arguments import message_bytes, readable
from cell_firmware.kernels.cell import BOARD
from cell_firmware.kernels.cell import METER as METER_RECORD
from cell_firmware.kernels.clock import CLOCK
from cell_firmware.kernels.lines import BYTES, LINE, LINES
from cell_firmware.kernels.speed_loop import LOOP
from cell_firmware.kernels.speed_loop import WHEELS as WHEELS_RECORD
from cell_firmware.kernels.watchdog import WATCHDOG
from cell_firmware.random_draws import CellStreams
from cell_firmware.refusals import REFUSALS, REFUSED, refuse

Bytes = NDArray[np.uint8]

_NAMES: Final = {"overwritten": "replaced"}
"""Fields of ``LINE`` that a mailbox's state calls otherwise."""


def compiled(controller: Controller) -> Controller:
    """Return the compiled form of a controller; the controller itself if there is none, or nothing to compile."""
    if not has_kernels(controller):
        return controller
    inside, clock, watchdog = controller, None, None
    if isinstance(inside, LocalClockWrapper):
        clock, inside = inside, inside.controller
    if isinstance(inside, WatchdogWrapper):
        watchdog, inside = inside, inside.controller
    if not isinstance(inside, Board) or any(
        part.constants() is None for part in (inside.wheels, inside.links, inside.tracer) if part is not None
    ):
        return controller
    message = inside.firmware.message
    if message is not None and message != check_message(message):  # with gaps between its fields
        return controller
    return CompiledController(controller, inside, clock, watchdog)


@final
@dataclass(frozen=True, slots=True)
class Hardware:
    """State of the boards of n cells, as the kernels have it: a record a cell of each part, and messages as bytes.

    Attributes:
        parts: The same memory by part and name, as the general controller has it.
        clocks, watches, wheels, cells, meters: ``(n,)`` records; none of a part that the boards don't have.
        waiting, going: ``(n, 4, size)``.
        there_ns: ``(n, slots, 4)``, when what ``there`` has arrives.
        there: ``(n, slots, 4, size)``.
        uarts: Serial lines byte by byte; None without. The other arrays of lines have nothing then.
    """

    parts: Mapping[str, State]
    clocks: NDArray[Any]
    watches: NDArray[Any]
    wheels: NDArray[Any]
    cells: NDArray[Any]
    meters: NDArray[Any]
    waiting: Bytes
    going: Bytes
    there_ns: NDArray[np.int64]
    there: Bytes
    uarts: LinkMemory | None


@final
class CompiledController(Controller):
    """Controller whose board, clock, and watchdog are compiled; programs are stepped as by ``Board``.

    State, outputs, registers, and counters are those of the general controller, which stays at hand for what is rare:
    the state before tick 0, resets by a watchdog, and faults that are injected later. Unlike there, a step changes the
    memory of the boards in place: the state before it is used up.

    Args:
        general: The controller.
        board: Its board.
        clock: Its clock; None: all cells are stepped at once.
        watchdog: Its watchdog; None: there is none.
    """

    def __init__(
        self,
        general: Controller,
        board: Board,
        clock: LocalClockWrapper | None,
        watchdog: WatchdogWrapper | None,
    ) -> None:
        self._general = general
        self._board = board
        self._program = Board(board.firmware, seed=board.seed)
        self._message, self._line = board.firmware.message, board.link_type
        self._slots = 0
        self.constants = self._described(board, clock, watchdog)
        self._bound: Hardware | None = None

    def _described(
        self, board: Board, clock: LocalClockWrapper | None, watchdog: WatchdogWrapper | None
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Return the records of constants: of the board, of its links, and of its speed loop."""
        boards = np.zeros(1, dtype=BOARD)
        boards["meter"] = board.meter is not None
        boards["lines"] = board.links is not None
        boards["wheels"] = board.wheels is not None
        if clock is not None:
            boards["clock"] = True
            boards["period_ns"] = clock.clocks.clocks.period_ns
            boards["window_ns"] = clock.clocks.clocks.window_ns
        self._watched, self._clocked = watchdog is not None, clock is not None
        if watchdog is not None:
            boards["watchdog"] = True
            boards["timeout_ns"], boards["reboot_ns"] = watchdog.timeout_ns, watchdog.reboot_ns
            boards["period_ns"], boards["divider_ns"] = watchdog.period_ns, DIVIDER_NS
        links = None if board.links is None else board.links.constants()
        loops = None if board.wheels is None else board.wheels.constants()
        if links is None:
            links = np.zeros(1, dtype=LINES)
        if loops is None:
            loops = np.zeros(1, dtype=LOOP)
        self._slots = int(links["slots"][0])
        return boards, links, loops

    @property
    def link_type(self) -> np.dtype[Any] | None:
        """Type of a link's payload in a tick."""
        return self._line

    @property
    def message_type(self) -> np.dtype[Any] | None:
        """Type of the programs' messages."""
        return self._message

    @property
    def burst_bytes(self) -> int:
        """Bytes of what a serial line carries in a tick, where it is simulated byte by byte; else 0."""
        return self._line.itemsize if self._line is not None and self.constants[1]["kind"] == BYTES else 0

    @property
    def general(self) -> Controller:
        """The controller on arrays; both have the same state."""
        return self._general

    @property
    def speculative(self) -> bool:
        """False: a step changes the state in place."""
        return False

    def passes_on(self, state: ControllerState) -> bool:  # noqa: ARG002
        """True: a step has the parts of boards alone, and refuses messages as faults' wrappers do."""
        return True

    @property
    def hangs(self) -> bool:
        """Whether a cell whose program fails hangs, to be reset by its watchdog."""
        return self._watched

    @property
    def firmware(self) -> Firmware:
        """The cells' program."""
        return self._board.firmware

    @property
    def streams(self) -> CellStreams | None:
        """Random numbers of the program; None for a program that declares none."""
        return self._board.streams

    def init(self, cells: Cells) -> ControllerState:
        """The state before tick 0, as the general controller's."""
        return self._general.init(cells)

    def registers(self, state: ControllerState) -> dict[str, NDArray[Any]]:
        """Return copies of the registers, which the next step doesn't change."""
        return {name: value.copy() for name, value in self._general.registers(state).items()}

    def counters(self, state: ControllerState) -> dict[str, int]:
        """Return the counters."""
        return self._general.counters(state)

    def compute(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """Compute the control period of all cells with an instant in this exchange.

        Args:
            now: Of the exchange.
            state: Of n cells; its boards' memory is changed in place.
            inputs: Of these cells, with what the lines carry.
        """
        state, hardware = self.own(state)
        n, cells = len(state.cells), state.cells
        boards, links, loops = self.constants
        at_ns, runs, reset = (
            np.empty(n, dtype=np.int64),
            np.empty(n, dtype=np.bool_),
            np.empty(n, dtype=np.bool_),
        )
        received, message = self._lines_empty(n, self._message)
        running, resets = kernels.begin(
            now.tick, int(now.at_ns), boards, links, hardware.clocks, hardware.watches, hardware.cells,
            hardware.waiting, hardware.there_ns, hardware.there,
            *_given(inputs.inbox and inputs.inbox.received, inputs.inbox, n),
            at_ns, runs, reset, received, message_bytes(message),
        )  # fmt: skip
        if resets:
            state = self._reset(state, np.flatnonzero(reset))
        programs = ControllerState(cells, {PROGRAM: state.parts[PROGRAM]})
        if self._board.links is not None:
            inputs = inputs.with_inbox(Inbox(received, message))
        state, inputs = self._refused(state, inputs)
        # as by the wrapper of clocks: programs are stepped in the window before the exchange
        then = StepTime(now.tick - 1, now.at_ns) if self._clocked else now
        if running == n:
            programs, done = self._program.compute(then, programs, inputs)
        else:
            programs, done = self._program.compute_rows(np.flatnonzero(runs), then, programs, inputs)
        failures = in_tick(now.tick, done.failures) if self._clocked else done.failures
        failed = np.zeros(n, dtype=np.bool_)
        if done.failures:
            failed[list(done.failures)] = True
        served = np.ones(n, dtype=np.bool_) if done.served is None else done.served
        drive, (line_sent, line) = np.zeros((n, 2)), self._lines_empty(n, self._line)
        kernels.end(
            now.tick, boards, links, loops, hardware.clocks, hardware.watches, hardware.wheels, hardware.cells,
            hardware.meters, hardware.waiting, hardware.going, at_ns, runs,
            _flags(n) if inputs.inbox is None else readable(inputs.inbox.received), readable(done.drive), failed,
            readable(served), *_given(done.outbox and done.outbox.sent, done.outbox, n),
            readable(done.drive if inputs.encoder_m is None else inputs.encoder_m), drive, line_sent,
            message_bytes(line),
        )  # fmt: skip
        after = ControllerState(cells, {**state.parts, PROGRAM: programs.parts[PROGRAM]})
        outbox = done.outbox if self._board.links is None else Outbox(line_sent, line)
        if self._watched:  # a program that raised hangs
            return after, ControllerOutputs(drive, outbox, hung=failures)
        return after, ControllerOutputs(drive, outbox, failures)

    def _refused(self, state: ControllerState, inputs: Inputs) -> tuple[ControllerState, Inputs]:
        """Refuse implausible messages, if the state has a part for their numbers."""
        own = state.parts.get(REFUSALS)
        if own is None or inputs.inbox is None:
            return state, inputs
        inbox, refused = refuse(self.firmware, inputs.inbox)
        own = {**own, REFUSED: own[REFUSED] + refused}
        return ControllerState(state.cells, {**state.parts, REFUSALS: own}), inputs.with_inbox(inbox)

    def _lines_empty(self, n: int, kind: np.dtype[Any] | None) -> tuple[Bools, Messages]:
        """Zeros for what lines carry or bring; without lines a row, as messages pass whole."""
        return (
            (_flags(n), _messages(n, kind))
            if self._board.links is not None
            else (_flags(1), _messages(1, None))
        )

    def _reset(self, state: ControllerState, rows: NDArray[np.int64]) -> ControllerState:
        """Reset the programs and boards of cells whose watchdog has timed out."""
        fresh = self._board.reset(state.select(rows), warm=True)
        for name, part in fresh.parts.items():
            if name != PROGRAM:
                for array, values in part.items():
                    state.parts[name][array][rows] = values
        programs = ControllerState(state.cells, {PROGRAM: state.parts[PROGRAM]})
        programs = programs.replace_rows(rows, ControllerState(fresh.cells, {PROGRAM: fresh.parts[PROGRAM]}))
        return ControllerState(state.cells, {**state.parts, **programs.parts})

    def own(self, state: ControllerState) -> tuple[ControllerState, Hardware]:
        """Return the state with its boards in records; in those of the last step, if it comes from there."""
        bound = self._bound
        if bound is None or any(state.parts[name] is not part for name, part in bound.parts.items()):
            self._bound = bound = self._hardware(state)
            for name, part in bound.parts.items():
                lost = state.parts[name].keys() - part.keys()
                assert not lost, (
                    f"this is a bug: kernels have no place for {', '.join(sorted(lost))} of {name}"
                )
            state = ControllerState(state.cells, {**state.parts, **bound.parts})
        return state, bound

    def _hardware(self, state: ControllerState) -> Hardware:
        """Copy the boards of a state into records."""
        n, parts = len(state.cells), dict[str, dict[str, NDArray[Any]]]()

        def records(name: str, kind: np.dtype[Any]) -> NDArray[Any]:
            if name not in state.parts:
                return np.zeros(0, dtype=kind)
            rows = np.zeros(n, dtype=kind)
            parts[name] = {}
            for array, values in state.parts[name].items():
                field = _NAMES.get(array, array)
                if field in (kind.names or ()):
                    view = rows[field]
                    parts[name][array] = view.view(np.bool_) if values.dtype == np.bool_ else view
                    parts[name][array][...] = values
            return rows

        def messages(array: str) -> Bytes:
            own = _messages(n, self._message)
            if uarts is None and array in state.parts.get(LINKS, {}):
                own[...] = state.parts[LINKS][array]
                parts[LINKS][array] = own
            return message_bytes(own)

        uarts = None if self._board.links is None else self._board.links.bind(state.parts[LINKS])
        if uarts is not None:
            links = self.constants[1]
            links["uarts"] = uarts.record.ctypes.data
            for name, address in uarts.kernels.items():
                links[name] = address
            parts[LINKS] = dict(uarts.parts)
        cells = records(LINKS, LINE) if uarts is None else np.zeros(0, dtype=LINE)
        there_ns = np.zeros((n, self._slots, 4), dtype=np.int64)
        there = np.zeros((n, self._slots, 4), dtype=self._line or np.uint8)
        for slot in range(self._slots):
            at_ns, message = f"there_{slot}_ns", f"message_{slot}"
            parts[LINKS][at_ns], parts[LINKS][message] = there_ns[:, slot], there[:, slot]
            for array in (at_ns, message):
                parts[LINKS][array][...] = state.parts[LINKS][array]
        meters = records(METER, METER_RECORD)
        if len(meters):
            meters["neighbours"] = state.cells.has_neighbour
        mailbox = messages("message")
        return Hardware(
            parts,
            records(LocalClockWrapper.part, CLOCK),
            records(WatchdogWrapper.part, WATCHDOG),
            records(WHEELS, WHEELS_RECORD),
            cells,
            meters,
            mailbox if LINKS in parts and "message" in parts[LINKS] else messages("waiting"),
            messages("going"),
            there_ns,
            message_bytes(there),
            uarts,
        )


def _flags(n: int) -> Bools:
    return np.zeros((n, 4), dtype=np.bool_)


def _messages(n: int, kind: np.dtype[Any] | None) -> Messages:
    """Zeros for the messages of n cells; a byte each where there are none."""
    return np.zeros((n, 4), dtype=np.uint8 if kind is None else kind)


def _given(sent: Bools | None, box: Inbox | Outbox | None, n: int) -> tuple[Bools, Bytes]:
    """Return an inbox or outbox as kernels read it; an empty one where there is none."""
    if box is None or sent is None:
        return readable(_flags(n)), readable(np.zeros((n, 4, 1), dtype=np.uint8))
    return readable(sent), readable(message_bytes(np.ascontiguousarray(box.message)))
