"""A shard's tick in one call of a kernel: for programs in scalar form, on boards that have kernels."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final, Protocol, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import SIDES
from cell_firmware.board import PROGRAM
from cell_firmware.compiled import CompiledController, Hardware
from cell_firmware.controller import ControllerState
from cell_firmware.effects.base import InputFilter
from cell_firmware.effects.sensor import Debounce
from cell_firmware.errors import FirmwareFailed
from cell_firmware.firmware import Bools, Cells, Floats, Messages, State
from cell_firmware.kernels import shard as kernels
from cell_firmware.kernels.arguments import readable
from cell_firmware.kernels.memory import entry_address
from cell_firmware.kernels.plausibility import refuse
from cell_firmware.kernels.values import draft_words
from cell_firmware.message_drafts import WIDE, as_written
from cell_firmware.message_values import misfit, values_of
from cell_firmware.refusals import REFUSALS, REFUSED, plausibility_checks
from cell_firmware.scalar import ScalarFirmware, parameters_record, state_records
from cell_firmware.shard_links import Indices, ShardLinks

Outboxes = tuple[Bools, Messages]
"""Whether a slot has a message, ``(4 n,)``, and the messages, ``(4 n,)`` of the type of links."""

_Done = TypeVar("_Done")
_NO_FAILURES: Final[Mapping[int, FirmwareFailed]] = {}


@final
@dataclass(frozen=True, slots=True)
class TickResult:
    """Result of a shard's tick.

    Attributes:
        drive: ``(n, 2)``.
        sent: ``(links,)``, whether a message leaves over a link of the border.
        message: ``(links,)``, these messages.
        failures: Failures by row of the cell among the live ones.
    """

    drive: Floats
    sent: Bools
    message: Messages
    failures: Mapping[int, FirmwareFailed]


@final
@dataclass(frozen=True, slots=True)
class TickBuffers:
    """Inputs and outputs of a shard's tick, in one place for all ticks.

    Attributes:
        presence: ``(n, sensors)``.
        encoder_m: ``(n, 2)``.
        received: ``(l,)``, whether a message came over a link of the border, ...
        border: ... and ``(l,)``, these messages.
        drive: ``(n, 2)``.
        sent: ``(m,)``, whether a message leaves over a link of the border, ...
        message: ... and ``(m,)``, these messages.
    """

    presence: Bools
    encoder_m: Floats
    received: Bools
    border: Messages
    drive: Floats
    sent: Bools
    message: Messages

    @staticmethod
    def of(links: ShardLinks, line: np.dtype[Any], sensors: int) -> TickBuffers:
        """Return the buffers of a shard."""
        n, incoming, outgoing = links.cells, len(links.in_to), len(links.out_from)
        return TickBuffers(
            np.zeros((n, sensors), dtype=np.bool_),
            np.zeros((n, 2)),
            np.zeros(incoming, dtype=np.bool_),
            np.zeros(incoming, dtype=line),
            np.zeros((n, 2)),
            np.zeros(outgoing, dtype=np.bool_),
            np.zeros(outgoing, dtype=line),
        )

    def by_name(self) -> dict[str, NDArray[Any]]:
        """Return the arrays by their names in ``kernels.SHARD``."""
        return {
            "bits": self.presence,
            "encoder_m": self.encoder_m,
            "border_received": self.received,
            "border": self.border,
            "drive": self.drive,
            "border_sent": self.sent,
            "border_out": self.message,
        }


class Threads(Protocol):
    """Threads that share work with the calling thread."""

    threads: int
    """How many."""

    def map_ranges(self, count: int, do: Callable[[int, slice], _Done], least: int) -> list[_Done]:
        """Have ``range(count)`` done in shares of ``least`` or more, side by side; return what ``do`` returned."""
        ...


def shard_kernel(
    controller: CompiledController,
    links: ShardLinks,
    filters: Sequence[InputFilter],
    sensors: int,
    period_ns: int,
    threads: Threads | None = None,
) -> ShardKernel | None:
    """Return the kernel of a shard; None if its program is not in scalar form, or for filters but debouncing.

    Args:
        controller: The cells' controller.
        links: Links of the shard.
        filters: Filters of the inputs, in order of application.
        sensors: Presence sensors of a cell.
        period_ns: Time from one exchange to the next.
        threads: Threads that step cells at the same time; None: the calling one alone.
    """
    debouncing = [one for one in filters if isinstance(one, Debounce)]
    if not isinstance(controller.firmware, ScalarFirmware) or len(debouncing) < len(filters):
        return None
    if not controller.firmware.is_compiled():
        return None
    if len(debouncing) > 1:
        return None
    debounce = debouncing[0] if debouncing else None
    return ShardKernel(controller, controller.firmware, links, debounce, sensors, period_ns, threads)


@final
class ShardKernel:
    """Tick of all live cells of a shard in one call.

    The state that was bound last is changed in place, and so are the outboxes and the debouncing's memory.

    Args:
        controller: The cells' controller; its program is in scalar form.
        firmware: That program.
        links: Links of the shard.
        debounce: Debouncing of presence bits; None: bits are taken as they are.
        sensors: Presence sensors of a cell.
        period_ns: Time from one exchange to the next, at which all cells read; unless they have clocks of their own.
        threads: Threads that step cells at the same time; None: the calling one alone.

    Attributes:
        buffers: Inputs and outputs of a tick.
        hangs: Whether a cell whose program fails hangs, to be reset by its watchdog.
        is_brief: Whether a tick always returns soon.
        outboxes: Messages of the last ticks that are not read yet, oldest first; one list while a state is bound.
    """

    def __init__(
        self,
        controller: CompiledController,
        firmware: ScalarFirmware,
        links: ShardLinks,
        debounce: Debounce | None,
        sensors: int,
        period_ns: int,
        threads: Threads | None,
    ) -> None:
        module = self._module = firmware.scalar_kernels()
        self._compared_ticks = getattr(module, "compared_ticks", 0)
        self.hangs = controller.hangs
        self.is_brief = firmware.is_brief
        self._controller = controller
        self._links = links
        self._cells, self._sensors, self._period_ns = links.cells, sensors, period_ns
        self._debounce = debounce
        self._line = np.dtype(np.bool_) if controller.link_type is None else controller.link_type
        self._streams, self._random = controller.streams, firmware.random
        self._parameters = parameters_record(module.PARAMETERS, firmware.constants())
        self._records: NDArray[Any] = np.zeros(0, dtype=module.STATE)
        self._program: State = {}
        self._threads = threads
        self._shards: NDArray[Any] = np.zeros(0, dtype=kernels.SHARD)
        self._owned: list[NDArray[Any]] = []
        self.outboxes: list[Outboxes] = []
        self._spare: Outboxes | None = None
        """Outbox of a message that was read last, to be filled next."""
        self._failing, self._speed = np.zeros(0, dtype=np.bool_), np.zeros((0, 2))
        self._misfit = np.zeros(0, dtype=np.int64)
        self._bound: tuple[ControllerState, Indices | None, Bools | None] | None = None
        self.buffers = TickBuffers.of(links, self._line, sensors)

    def takes(self, state: ControllerState) -> bool:
        """Whether the kernel can step a state: if cells refuse messages, it must be able to check them."""
        return REFUSALS not in state.parts or plausibility_checks(self._controller.firmware) is not None

    def is_bound(self, state: ControllerState, rows: Indices | None, outboxes: Sequence[Outboxes]) -> bool:
        """Whether these are the objects that the last step left, or that were bound since."""
        bound = self._bound
        return (
            bound is not None
            and bound[0] is state
            and bound[1] is rows
            and self.outboxes is outboxes
            and (self._debounce is None or bound[2] is self._debounce.memory[0])
        )

    def bind(
        self, state: ControllerState, rows: Indices | None, outboxes: Sequence[Outboxes]
    ) -> ControllerState:
        """Put a state into the kernel's memory; the outboxes are copied.

        Args:
            state: Of the live cells.
            rows: Their rows among the shard's cells; None: all live.
            outboxes: Messages of the last ticks that are not read yet, oldest first.

        Returns:
            The state, in that memory.
        """
        state, hardware = self._controller.own(self._with_own_refusals(state))
        live, n = len(state.cells), self._cells
        program = state.parts[PROGRAM]
        if program is not self._program or len(self._records) != live:
            self._records, self._program = state_records(self._module.STATE, program, live)
            state = ControllerState(state.cells, {**state.parts, PROGRAM: self._program})
        fields = dict[str, Any](cells=n, live=live, sensors=self._sensors, debounce_ticks=1)
        fields |= {
            "messages": self._controller.link_type is not None,
            "slots": hardware.there.shape[1],
            "burst": self._controller.burst_bytes,
            "links_in": len(self._links.in_to),
            "links_out": len(self._links.out_from),
            "period_ns": self._period_ns,
            "bounces": 0,
        }
        self._owned = []
        self._bind_boards(fields, hardware)
        self._bind_links(fields, rows, outboxes)
        self._bind_program(fields, state.cells)
        self._bind_sensors(fields)
        self._bind_refusals(fields, state)
        fields |= {name: self._address(array) for name, array in self.buffers.by_name().items()}
        self._share(fields, live)
        self._bound = (state, rows, None if self._debounce is None else self._debounce.memory[0])
        return state

    def step(
        self, tick: int, presence: Bools, encoder_m: Floats | None, links: Outboxes | None
    ) -> TickResult | None:
        """Step the live cells of the bound state.

        Args:
            tick: Of the exchange with the plant.
            presence: ``(n, sensors)``.
            encoder_m: ``(n, 2)``; None without encoders.
            links: Messages over the border; None: none.

        Returns:
            The result; None if nothing was done, since a watchdog resets a cell in this tick.
        """
        buffers = self.buffers
        buffers.presence[...] = presence
        if encoder_m is not None:
            buffers.encoder_m[...] = encoder_m
        if links is None:
            buffers.received[...] = False
        else:
            buffers.received[...], buffers.border[...] = links
        failures = self.run(tick)
        return None if failures is None else self.result(failures)

    def result(self, failures: Mapping[int, FirmwareFailed]) -> TickResult:
        """Return a copy of the buffers' outputs."""
        buffers = self.buffers
        return TickResult(buffers.drive.copy(), buffers.sent.copy(), buffers.message.copy(), failures)

    def run(self, tick: int) -> Mapping[int, FirmwareFailed] | None:
        """Step the live cells of the bound state, from and to the buffers.

        Args:
            tick: Of the exchange with the plant.

        Returns:
            Failures by row of the cell among the live ones; None if nothing was done, since a watchdog resets a cell in
            this tick, or the program's two forms are compared.
        """
        if tick < self._compared_ticks:
            return None
        failures, bounces = self._tick(tick)
        if failures == kernels.RESETS:
            return None
        self._turn_outboxes()
        if bounces and self._debounce is not None:
            self._debounce.counters["bounces"] += bounces
        return self._failed(tick) if failures else _NO_FAILURES

    def _tick(self, tick: int) -> tuple[int, int]:
        """Step all live cells; return what ``kernels.run_tick`` does."""
        shards, step = self._shards, self._module.tick
        if len(shards) == 1:
            return step(tick, shards)
        assert self._threads is not None, "this is a bug: shares for no threads"
        first, shares, last = shards[:1], shards[1:-1], shards[-1:]
        done = [step(tick, first)]
        if done[0][0] == kernels.RESETS:
            return done[0]
        done += self._threads.map_ranges(len(shares), lambda _, which: step(tick, shares[which]), 1)
        done.append(step(tick, last))
        return sum(failures for failures, _ in done), sum(bounces for _, bounces in done)

    def _share(self, fields: Mapping[str, Any], live: int) -> None:
        """Fill a record for the shard; or one for each thread's share of its cells, and one before and after these."""
        threads = 1 if self._threads is None else self._threads.threads
        shares = [(0, live)]
        if threads > 1:
            shares = [(k * live // threads, (k + 1) * live // threads) for k in range(threads)]
            shares = [(0, 0), *shares, (0, 0)]
        self._shards = np.zeros(len(shares), dtype=kernels.SHARD)
        for name, value in fields.items():
            self._shards[name] = value
        self._shards["opens"][0] = self._shards["closes"][-1] = True
        for k, (first, last) in enumerate(shares):
            shard = self._shards[k : k + 1]
            shard["first"], shard["last"] = first, last
            for name, array in self._scratch().items():
                shard[name] = self._address(array)

    def _scratch(self) -> dict[str, NDArray[Any]]:
        """Return memory for the cell that is stepped."""
        message = self._module.MESSAGE
        return {
            "line_received": np.zeros(4, dtype=np.bool_),
            "line": np.zeros(4, dtype=self._line),
            "line_brings": np.zeros(4, dtype=np.bool_),
            "brought": np.zeros(4, dtype=message),
            "line_takes": np.zeros(4, dtype=np.bool_),
            "taken": np.zeros(4, dtype=message),
            "checked": np.zeros((4, draft_words(message))),
        }

    def _failed(self, tick: int) -> dict[int, FirmwareFailed]:
        assert self._bound is not None, "this is a bug: a step before a state was bound"
        cells = self._bound[0].cells
        return {
            i: FirmwareFailed(cells.name(i), tick, self._problem(i))
            for i in np.flatnonzero(self._failing).tolist()
        }

    def _problem(self, i: int) -> str:
        """Return the problem of a live cell whose program failed in the last tick."""
        if self._misfit[i] < 0:
            return f"drive is not finite: speed {self._speed[i].tolist()} m/s"
        values = values_of(self._module.MESSAGE)
        side, place = divmod(int(self._misfit[i]), len(values))
        value, words = values[place], self._speed[i]
        number = as_written(words.view(WIDE[value.type]))[0] if value.type in WIDE else float(words[0])
        return misfit(value, SIDES[side], number)

    def _address(self, array: NDArray[Any]) -> int:
        """Address of an array in one piece, kept alive until the next binding."""
        assert array.flags.c_contiguous, "this is a bug: an array in pieces"
        self._owned.append(array)
        return array.ctypes.data

    def _bind_boards(self, fields: dict[str, Any], hardware: Hardware) -> None:
        boards, links, loops = self._controller.constants
        arrays = {
            "boards": boards,
            "links": links,
            "loops": loops,
            "clocks": hardware.clocks,
            "watches": hardware.watches,
            "wheels": hardware.wheels,
            "lines": hardware.cells,
            "meters": hardware.meters,
            "waiting": hardware.waiting,
            "going": hardware.going,
            "there_ns": hardware.there_ns,
            "there": hardware.there,
        }
        fields |= {name: self._address(array) for name, array in arrays.items()}

    def _turn_outboxes(self) -> None:
        """Exchange the outboxes after a tick: the one just filled, and the one to be read next."""
        assert self._spare is not None, "this is a bug: a step before a state was bound"
        read = self.outboxes.pop(0)
        self.outboxes.append(self._spare)
        self._spare = read
        if len(self.outboxes) > 1:  # else the kernel exchanges both by itself
            self._shards["current"] = 0
            for name, value in self._outbox_addresses().items():
                self._shards[name] = value

    def _outbox_addresses(self) -> dict[str, int]:
        """Return the addresses of two outboxes: to be read in the next tick, and to be filled."""
        assert self._spare is not None, "this is a bug: there are no outboxes"
        found = dict[str, int]()
        for i, (sent, message) in enumerate((self.outboxes[0], self._spare)):
            found[f"sent_{i}"], found[f"outbox_{i}"] = sent.ctypes.data, message.ctypes.data
        return found

    def _bind_links(self, fields: dict[str, Any], rows: Indices | None, outboxes: Sequence[Outboxes]) -> None:
        n = self._cells
        empty = [
            (np.zeros(4 * n, dtype=np.bool_), np.zeros(4 * n, dtype=self._line))
            for _ in range(len(outboxes) + 1)
        ]
        *self.outboxes, self._spare = empty
        if fields["messages"]:
            for own, given in zip(self.outboxes, outboxes, strict=True):
                own[0][...], own[1][...] = given
                own[1][~own[0]] = np.zeros((), dtype=self._line)
        fields["current"] = 0
        fields |= self._outbox_addresses()
        fields["rows"] = self._address((np.arange(n) if rows is None else rows).astype(np.int32))
        fields["source"] = self._address(self._links.sources().astype(np.int32))
        fields["border_from"] = self._address(readable(self._links.out_from))

    def _bind_program(self, fields: dict[str, Any], cells: Cells) -> None:
        live = len(cells)
        if self._streams is not None:
            fields["random_keys"] = self._address(self._streams.keys)
            fields["places"] = self._address(np.stack((cells.row, cells.column), axis=1))
        fields["parameters"], fields["states"] = self._address(self._parameters), self._address(self._records)
        self._failing, self._speed = np.zeros(live, dtype=np.bool_), np.zeros((live, 2))
        self._misfit = np.zeros(live, dtype=np.int64)
        fields["failed"], fields["speed"] = self._address(self._failing), self._address(self._speed)
        fields["misfit"] = self._address(self._misfit)

    def _with_own_refusals(self, state: ControllerState) -> ControllerState:
        """Return a state whose numbers of refused messages are written to by the kernel alone."""
        if REFUSALS not in state.parts:
            return state
        own = state.parts[REFUSALS]
        return ControllerState(state.cells, {**state.parts, REFUSALS: {**own, REFUSED: own[REFUSED].copy()}})

    def _bind_refusals(self, fields: dict[str, Any], state: ControllerState) -> None:
        """Have implausible messages refused, if the state has a part for their numbers."""
        if REFUSALS not in state.parts:
            return
        checks = plausibility_checks(self._controller.firmware)
        assert checks is not None, "this is a bug: a state that the kernel doesn't take"
        if not len(checks):
            return
        fields["refuse"] = entry_address(refuse)
        fields["checks"], fields["checks_count"] = self._address(checks), len(checks)
        fields["refused"] = self._address(state.parts[REFUSALS][REFUSED])

    def _bind_sensors(self, fields: dict[str, Any]) -> None:
        debounce = self._debounce
        if debounce is None:
            return
        fields["debounce_ticks"] = debounce.ticks
        fields["clock_period_ns"], fields["clock_window_ns"], ppb, phase_ns = debounce.clocks
        fields["ppb"], fields["phase_ns"] = self._address(ppb), self._address(phase_ns)
        believed, readings = debounce.memory
        fields["believed"], fields["readings"] = self._address(believed), self._address(readings)
