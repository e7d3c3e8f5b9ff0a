"""The cells of one process: their state, the links among them, and the links to other processes."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.errors import StateError
from bus.lattice import NO_TICK_LIMIT
from bus.partition import Partition
from bus.sensors import CameraFrame, Labels
from bus.state import StateFields
from bus.wire.fixed_layout import Layouts
from bus.wire.message_type import leaves
from cell_firmware.board import PROGRAM, has_kernels
from cell_firmware.controller import Controller, ControllerState, StepTime, read_only
from cell_firmware.effects.base import InputFilter
from cell_firmware.errors import FirmwareError, FirmwareFailed
from cell_firmware.firmware import Bools, Cells, Floats, Inbox, Inputs, Messages, Outbox, State
from cell_firmware.shard_links import Indices, ShardLinks
from cell_firmware.specs import nanoseconds

if TYPE_CHECKING:
    from bus.fault import FaultInstance
    from bus.lattice import Lattice
    from cell_firmware.effects.base import ShardContext
    from cell_firmware.faults.attach import ShardFaults
    from cell_firmware.faults.base import CellFault
    from cell_firmware.payload_codec import PayloadCodec
    from cell_firmware.shard_kernel import ShardKernel, Threads, TickResult

_EVERY: Final = slice(None)
FAULTS: Final = "faults"
"""Name of the faults' input filters, which are applied after the filters of all effects."""
MESSAGES: Final = "message."
"""Prefix of the registers that show messages: ``message.sent`` ``(n, 4)``, and one a field, by side."""


Sent = tuple[Bools, Messages]
"""Whether a slot has a message, ``(4 n,)``, and the messages, ``(4 n,)`` of the type of links."""


@final
@dataclass(frozen=True, slots=True)
class BoundaryMessages:
    """Messages on a shard's border, one row a link.

    Attributes:
        sent: ``(L,)``: is there a message?
        message: ``(L,)`` of the firmware's message type; zero where there is none.
    """

    sent: Bools
    message: Messages


@final
@dataclass(frozen=True, slots=True)
class ShardOutputs:
    """Outputs of a shard in a tick.

    Attributes:
        drive: ``(n, 2)`` float64, volts or m/s; zero for dead cells.
        links: Messages sent over the border; None for firmware without messages.
        failures: Cells whose firmware failed in this tick; they are retired already.
        hung: Cells whose firmware failed in this tick and hangs since; they stay live.
    """

    drive: Floats
    links: BoundaryMessages | None
    failures: tuple[FirmwareFailed, ...]
    hung: tuple[FirmwareFailed, ...] = ()


@final
class Shard:
    """Cells of one process, stepped together; the results are the same bytes for any partition of the array.

    A message sent in tick k is read ``link_ticks`` later, over the border or not. Links of the border are in the
    order of ``partition.outgoing(shard)`` and ``partition.incoming(shard)``.

    Args:
        controller: Controller of the cells; its compiled form is stepped where there is one.
        cells: All cells of the array, in the lattice's order.
        partition: Partition of the array into shards.
        shard: Number of the shard.
        effects: Input filters by name of the effect, in order of application.
        faults: Faults whose filters are in ``effects``, or that the controller carries out.
        link_ticks: Ticks after which a message is read.
        threads: Threads that step the cells of a large shard at the same time; None: the calling one alone.

    Attributes:
        indices: ``(n,)``, the cells of this shard, by index into the lattice.
        cells: ``(row, column)`` of each cell.
        shows_messages: Whether ``registers`` has the messages of the last tick, too.

    Raises:
        FirmwareFailed: The firmware's ``init`` failed.
    """

    state_fields: ClassVar[StateFields] = StateFields(
        "_tick", "_active", "_retired", "_drive", "_outboxes", "_effects", "_memory"
    )

    def __init__(
        self,
        controller: Controller,
        cells: Cells,
        partition: Partition,
        shard: int,
        effects: Mapping[str, Sequence[InputFilter]] | None = None,
        faults: Sequence[FaultInstance[CellFault]] = (),
        *,
        link_ticks: int = 1,
        threads: Threads | None = None,
    ) -> None:
        self.indices: Indices = partition.cells(shard)
        self.cells: tuple[tuple[int, int], ...] = tuple(
            partition.lattice.cells[int(i)] for i in self.indices.tolist()
        )
        self._n = len(self.indices)
        self._effects = effects or {}
        self._faults: ShardFaults | None = None
        self._form_end_tick = NO_TICK_LIMIT
        """First tick in which the cells may be stepped in another form."""
        self._stages = tuple(stage for stages in self._effects.values() for stage in stages)
        self._message = controller.link_type
        self._general = controller.general
        self._state: ControllerState = controller.init(cells.select(self.indices))
        self._active: Indices | None = None  # rows still alive, once some are not
        self._retired = Counter[str]()  # what the others' boards had counted
        self._period_ns = nanoseconds(cells.period_s)
        self.shows_messages = False
        self._tick = -1
        self._drive = np.zeros((self._n, 2))
        self._outboxes: list[Sent] = [self._nothing() for _ in range(link_ticks)]
        """Messages that are not read yet, a tick each, oldest first."""

        self._links = ShardLinks.of(partition, shard)
        undisturbed = controller
        if faults:
            from cell_firmware.faults.attach import without_faults

            undisturbed = without_faults(controller)
            self._attach(controller, faults, partition.lattice)
        self._undisturbed = self._compiled(undisturbed, cells.sensors, threads)
        """Controller and kernel of ticks in which no fault acts."""
        self._controller, self._kernel = self._undisturbed

    def _compiled(
        self, controller: Controller, sensors: int, threads: Threads | None
    ) -> tuple[Controller, ShardKernel | None]:
        """Return the compiled form of a controller, and the kernel of the shard's ticks; None without one.

        No kernels are loaded where there is nothing to compile.
        """
        if not has_kernels(controller):
            return controller, None
        from cell_firmware.compiled import CompiledController, compiled

        controller = compiled(controller)
        if not isinstance(controller, CompiledController):
            return controller, None
        from cell_firmware.shard_kernel import shard_kernel

        filters = [one for name, stages in self._effects.items() if name != FAULTS for one in stages]
        return controller, shard_kernel(controller, self._links, filters, sensors, self._period_ns, threads)

    def _nothing(self) -> Sent:
        """Return the messages of a tick in which nothing was sent."""
        return np.zeros(self._n * 4, dtype=np.bool_), np.zeros(self._n * 4, dtype=self._message or np.bool_)

    @property
    def message(self) -> np.dtype[np.void] | None:
        """Type of the messages; None if there are none."""
        return self._message

    def __len__(self) -> int:
        return self._n

    def step(
        self,
        tick: int,
        presence: Bools,
        encoder_m: Floats | None = None,
        links: BoundaryMessages | None = None,
        level: Floats | None = None,
        *,
        label: Labels | None = None,
        camera: CameraFrame | None = None,
    ) -> ShardOutputs:
        """Step all cells by one control period.

        Args:
            tick: The tick: one more than the last.
            presence: ``(n, sensors)``, the cells' presence bits.
            encoder_m: ``(n, 2)``, surface travel of the wheels, m; None without encoders.
            links: Messages received over the border that are due in this tick; None where nothing was sent yet,
                without messages, or where there is no border.
            level: ``(n, sensors)``, how much of each sensor's spot is covered; None unless sensors are analogue.
            label: ``(n,)``, readings of scanners; None without scanners.
            camera: Frame of a camera; None in ticks without a frame.

        Returns:
            Drives, outgoing messages, and the cells that failed in this tick.
        """
        if tick != self._tick + 1:
            raise FirmwareError(f"this is a bug: a shard was given tick {tick} after tick {self._tick}")
        self._tick = tick
        if tick >= self._form_end_tick:
            self._choose_form(tick)
        if self._kernel is not None and level is None and label is None and camera is None:
            outputs = self._step_by_kernel(self._kernel, presence, encoder_m, links)
            if outputs is not None:
                return outputs
        inputs = Inputs(presence, encoder_m, self._inbox(links), level, label, camera)
        for stage in self._stages:
            inputs = stage.apply(tick, inputs, _EVERY if self._active is None else self._active)
        drive = np.zeros((self._n, 2))
        silence: Sent = np.zeros(self._n * 4, dtype=np.bool_), self._outboxes[-1][1]
        self._outboxes = [*self._outboxes[1:], silence]
        failures: tuple[FirmwareFailed, ...] = ()
        hung: tuple[FirmwareFailed, ...] = ()
        if len(self._state.cells):
            active = self._active
            if active is not None:
                inputs = inputs.select(active)
            now = StepTime(tick, np.array(tick * self._period_ns))
            state, inputs = self._controller.receive(now, self._state, inputs)
            self._state, outputs = self._controller.compute(now, state, inputs)
            if active is None:
                drive = outputs.drive
            else:
                drive[active] = outputs.drive
            if outputs.outbox is not None and self._message is not None:
                self._outboxes[-1] = self._sent_by_all(outputs.outbox, self._message)
            if outputs.failures:
                failures = tuple(outputs.failures[i] for i in sorted(outputs.failures))
                self.retire(failure.cell for failure in failures)
            hung = tuple(outputs.hung[i] for i in sorted(outputs.hung))
        self._drive = drive
        return ShardOutputs(drive, self.boundary_links, failures, hung)

    @property
    def is_brief(self) -> bool:
        """Whether ``step_payload`` always returns soon: programs of users, which may loop, don't promise that."""
        kernel = self._undisturbed[1]
        return kernel is not None and kernel.is_brief

    def payload_codec(self, layouts: Layouts) -> PayloadCodec | None:
        """Return the codec of the payloads that ``step_payload`` takes and returns; None if it takes none.

        Args:
            layouts: From a tick to the layouts of the shard's only payload each way; None: there are others.
        """
        kernel = self._undisturbed[1]
        if kernel is None or layouts(0) is None:
            return None
        from cell_firmware.payload_codec import PayloadCodec

        return PayloadCodec(layouts, kernel.buffers)

    def step_payload(self, codec: PayloadCodec, tick: int, payload: bytes) -> bytes | ShardOutputs | None:
        """Step all cells by one control period, from payload to payload.

        Args:
            codec: Of ``payload_codec``.
            tick: The tick: one more than the last.
            payload: The senses.

        Returns:
            The drives; or the outputs, where programs failed; or None where nothing was done: ``step`` takes what
            came, since the payload is no such one, a watchdog resets a cell or a fault acts.
        """
        kernel = self._kernel
        if kernel is None or tick != self._tick + 1 or tick >= self._form_end_tick:
            return None
        self._bind(kernel)
        if not codec.read(tick, payload):
            return None
        failures = kernel.run(tick)
        if failures is None:
            return None
        self._tick = tick
        self._drive = kernel.buffers.drive
        if failures:
            return self._finish(kernel, kernel.result(failures))
        return codec.write(tick)

    def _step_by_kernel(
        self, kernel: ShardKernel, presence: Bools, encoder_m: Floats | None, links: BoundaryMessages | None
    ) -> ShardOutputs | None:
        """Step all cells in one call; None if a watchdog resets a cell, and nothing was done."""
        self._bind(kernel)
        received = None if links is None else (links.sent, links.message)
        done = kernel.step(self._tick, presence, encoder_m, received)
        return None if done is None else self._finish(kernel, done)

    def _bind(self, kernel: ShardKernel) -> None:
        """Put the state into the kernel's memory, unless it is there."""
        if not kernel.is_bound(self._state, self._active, self._outboxes):
            self._state = kernel.bind(self._state, self._active, self._outboxes)
            self._outboxes = kernel.outboxes  # one list from now on

    def _finish(self, kernel: ShardKernel, done: TickResult) -> ShardOutputs:
        """Return the outputs of a tick by the kernel, and retire cells whose programs failed for good."""
        self._drive = done.drive
        border = None if self._message is None else BoundaryMessages(done.sent, done.message)
        failures = tuple(done.failures[i] for i in sorted(done.failures))
        if failures and kernel.hangs:
            return ShardOutputs(done.drive, border, (), failures)
        if failures:
            self.retire(failure.cell for failure in failures)
        return ShardOutputs(done.drive, border, failures)

    def _inbox(self, links: BoundaryMessages | None) -> Inbox | None:
        """Collect the messages that are due, from inside the shard and over the border."""
        if self._message is None:
            return None
        from cell_firmware.kernels.messages import collect

        received = np.zeros((self._n, 4), dtype=np.bool_)
        message = np.zeros((self._n, 4), dtype=self._message)
        if links is None:
            links = _links(0, self._message)
        elif links.sent.shape != self._links.in_to.shape or links.message.shape != self._links.in_to.shape:
            raise FirmwareError(
                f"this is a bug: {links.message.shape} messages for {self._links.in_to.shape} incoming links"
            )
        sent, outgoing = self._outboxes[0]
        collect(
            self._message.itemsize, sent, outgoing.view(np.uint8),
            self._links.inner_from, self._links.inner_to,
            links.sent, links.message.view(np.uint8), self._links.in_to,
            received.reshape(-1), message.reshape(-1).view(np.uint8),
        )  # fmt: skip
        return Inbox(received, message)

    def _sent_by_all(self, outbox: Outbox, message: np.dtype[Any]) -> Sent:
        """Return the messages of the live cells in the rows of all cells."""
        if self._active is None:
            return outbox.sent.ravel(), outbox.message.ravel()
        sent = np.zeros((self._n, 4), dtype=np.bool_)
        outgoing = np.zeros((self._n, 4), dtype=message)
        sent[self._active], outgoing[self._active] = outbox.sent, outbox.message
        return sent.ravel(), outgoing.ravel()

    def retire(self, cells: Iterable[tuple[int, int]]) -> None:
        """Retire cells: no drive and no messages from now on; messages sent before still arrive.

        Args:
            cells: ``(row, column)`` of each; cells of other shards, or retired before, are ignored.
        """
        gone = set(cells)
        alive = self._state.cells
        keep = np.array([alive.name(i) not in gone for i in range(len(alive))], dtype=np.bool_)
        if keep.all():
            return
        rows = np.flatnonzero(keep)
        self._active = rows if self._active is None else self._active[rows]
        before = Counter(self._general.counters(self._state))
        self._state = self._state.select(rows)
        before.subtract(self._general.counters(self._state))
        self._retired.update(before)

    def start_at(self, tick: int) -> None:
        """Start at ``tick``, for cells that join a running simulation."""
        self._tick = tick - 1

    def inject(self, fault: FaultInstance[CellFault], site: ShardContext, lattice: Lattice) -> None:
        """Inject a fault, effective from the next tick at the earliest.

        Args:
            fault: The fault.
            site: The shard's cells.
            lattice: Lattice of the array.
        """
        faults = self._faults
        if faults is None:
            from cell_firmware.faults.attach import without_faults

            faults = self._attach(without_faults(self._general), (), lattice)
        stages = faults.inject(fault, site, link_ticks=len(self._outboxes))
        if stages:
            self._effects = {**self._effects, FAULTS: (*self._effects.get(FAULTS, ()), *stages)}
            self._stages += stages
        self._state = faults.begin(self._state, self._live_drive)
        if self._controller is self._general:
            self._controller = faults.controller
        self._general = faults.controller
        self._form_end_tick = 0

    def _attach(
        self, controller: Controller, faults: Sequence[FaultInstance[CellFault]], lattice: Lattice
    ) -> ShardFaults:
        """Have the form of the next tick decided by faults, which a controller carries out."""
        from cell_firmware.faults.attach import ShardFaults

        self._faults = ShardFaults(controller, faults, self._effects.get(FAULTS, ()), lattice)
        self._form_end_tick = 0
        return self._faults

    def _choose_form(self, tick: int) -> None:
        """Step the cells with the wrappers of faults from a tick on, or in their compiled form without them."""
        faults = self._faults
        assert faults is not None, "this is a bug: no form ends without faults"
        form = faults.form(tick, self._state)
        self._form_end_tick = form.end_tick
        controller, kernel = self._undisturbed
        if form.wrapped or not controller.passes_on(self._state):
            self._state = self._caught_up()
            self._controller, self._kernel = self._general, None
            return
        takes = kernel is not None and not form.filtered and kernel.takes(self._state)
        self._controller, self._kernel = controller, kernel if takes else None

    def _caught_up(self) -> ControllerState:
        """Return the state as it is where faults' wrappers carry out every tick."""
        if self._faults is None or self._controller is self._general:
            return self._state
        return self._faults.catch_up(self._state, self._live_drive)

    def repair(self, number: int, tick: int) -> None:
        """End a fault at ``tick``; an unknown fault is ignored."""
        if self._faults is not None:
            self._faults.repair(number, tick)
            self._form_end_tick = 0

    @property
    def _live_drive(self) -> Floats:
        """Drives of the live cells in the last tick."""
        return self._drive if self._active is None else self._drive[self._active]

    def registers(self) -> tuple[Indices, dict[str, NDArray[Any]]]:
        """Return the registers of live cells.

        Returns:
            ``(a, 2)`` row and column of each; by name, arrays with a row for each.
        """
        cells = self._state.cells
        registers = {name: value.copy() for name, value in self._general.registers(self._state).items()}
        if self.shows_messages and self._message is not None:
            registers = {**registers, **self._sent_messages(self._message)}
        return np.stack((cells.row, cells.column), axis=1), registers

    def _sent_messages(self, message: np.dtype[Any]) -> dict[str, NDArray[Any]]:
        """Return the messages of live cells in the last tick, by side, as registers."""
        rows = slice(None) if self._active is None else self._active
        sent, fields = (part.reshape(-1, 4)[rows] for part in self._outboxes[-1])
        return {
            f"{MESSAGES}sent": sent.copy(),
            **{f"{MESSAGES}{leaf.name}": leaf.of(fields).copy() for leaf in leaves(message)},
        }

    @property
    def program_state(self) -> State:
        """State of the live cells' programs, arrays by name with a row a cell in the order of ``alive``; copies."""
        return {name: array.copy() for name, array in self._state.parts[PROGRAM].items()}

    @program_state.setter
    def program_state(self, state: State) -> None:
        parts = {**self._state.parts, PROGRAM: read_only(state)}
        self._state = ControllerState(self._state.cells, parts)

    @property
    def outbox(self) -> Outbox:
        """Payloads of all cells' links that the next tick delivers, ``(n, 4)``; copies.

        Raises:
            FirmwareError: The program has no messages.
        """
        if self._message is None:
            raise FirmwareError("the program of the cells sends no messages")
        sent, outgoing = self._outboxes[0]
        return Outbox(sent.reshape(-1, 4).copy(), outgoing.reshape(-1, 4).copy())

    @outbox.setter
    def outbox(self, outbox: Outbox) -> None:
        self._outboxes = [(outbox.sent.ravel(), outbox.message.ravel()), *self._outboxes[1:]]

    def counters(self) -> Counter[str]:
        """Return the counters of effects and boards so far, by ``effect.counter``, retired cells included."""
        total = Counter(self._retired)
        for name, stages in self._effects.items():
            for stage in stages:
                total.update({f"{name}.{what}": number for what, number in stage.counters.items()})
        total.update(self._general.counters(self._state))
        return total

    @property
    def tick(self) -> int:
        """The last tick that was stepped; -1 before the first."""
        return self._tick

    @property
    def boundary_links(self) -> BoundaryMessages | None:
        """Messages sent over the border in the last tick; None for firmware without messages."""
        if self._message is None:
            return None
        from cell_firmware.kernels.messages import leave

        links = _links(len(self._links.out_from), self._message)
        sent, outgoing = self._outboxes[-1]
        leave(
            self._message.itemsize, sent, outgoing.view(np.uint8), self._links.out_from,
            links.sent, links.message.view(np.uint8),
        )  # fmt: skip
        return links

    @property
    def _memory(self) -> Mapping[str, State]:
        """State of live cells, by part of the controller."""
        return self._caught_up().parts

    @_memory.setter
    def _memory(self, parts: Mapping[str, State]) -> None:
        state = self._state if self._active is None else self._state.select(self._active)
        if _arrays(parts) != _arrays(state.parts):
            raise StateError(
                f"the cells' state: must have a row for each of {len(state.cells)} cells in "
                f"{', '.join(sorted(_arrays(state.parts)))}"
            )
        self._state = ControllerState(state.cells, {name: read_only(part) for name, part in parts.items()})
        if self._faults is not None:
            self._form_end_tick = 0

    @property
    def alive(self) -> tuple[tuple[int, int], ...]:
        """``(row, column)`` of the cells that still run."""
        return tuple(self._state.cells.name(i) for i in range(len(self._state.cells)))


def _arrays(parts: Mapping[str, State]) -> dict[str, int]:
    """Return the number of rows of each array of a state, by name."""
    return {f"{part}.{name}": len(array) for part, state in parts.items() for name, array in state.items()}


def _links(count: int, message: np.dtype[Any]) -> BoundaryMessages:
    """Return links of the border without messages."""
    return BoundaryMessages(np.zeros(count, dtype=np.bool_), np.zeros(count, dtype=message))
