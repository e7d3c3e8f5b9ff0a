"""The cells' side of the lockstep: one shard."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from bus.errors import BarrierError, CoordinatorLostError, WaitInterrupted
from bus.lattice import NO_TICK_LIMIT
from bus.lockstep.control import ControlState
from bus.lockstep.counters import MessageCounters
from bus.lockstep.intervals import Membership
from bus.lockstep.receive import Dispatcher
from bus.lockstep.registers import Own, RegisterPublisher, RegisterRequest
from bus.lockstep.reports import ReportPublisher
from bus.lockstep.shard_io import InboundFrames, OutboundFrames, ParticipantMembership, TickInputs
from bus.lockstep.snapshots import MessageBytes, SnapshotPublisher
from bus.partition import Partition
from bus.sensors import SensorSchema
from bus.spec import NO_LATENCY, BusSpec, StallSpec
from bus.transports.base import Endpoint, Event, Received, Wakeup
from bus.wire.fixed_layout import PayloadLayout
from bus.wire.format import ParticipantCodec, RunSchema
from bus.wire.formats import FORMATS, WireFormat
from bus.wire.frames import Control, DriveFrame, LinkFrame, Mask
from bus.wire.keys import plant_key, shard_key

_POLL_S: Final = 0.01
_ANSWER_S: Final = 1.0
"""Time that a shard whose cells have all failed waits for the plant's answer, wall seconds."""
_DIRECT_BYTES: Final = 1 << 15
"""Bytes of the largest payload that is sent by a thread of the transport: less than a batch of Zenoh's, 48 kB."""
_LEAVE_S: Final = 5.0
"""Time to wait, after the run, for the plant to receive the counters, wall seconds."""


def _is_small(layouts: tuple[PayloadLayout, PayloadLayout] | None) -> bool:
    """Whether a shard has one payload each way, and the answer is of at most ``_DIRECT_BYTES``."""
    return layouts is not None and len(layouts[1].constant) <= _DIRECT_BYTES


@final
class Participant:
    """Participant of the lockstep: gathers a shard's inputs, and publishes its drives and messages.

    Blocking; one thread at a time, but ``publish`` may be called from another while ``gather`` waits for the tick
    after. It subscribes at once. The endpoint stays the caller's, to close later.

    Args:
        endpoint: The endpoint of the shard's process.
        partition: Partition of the cells into shards; the same on all sides.
        shard: Number of the shard.
        form: Name of the wire format; the same on all sides.
        run: Name of the run.
        readings: Contents of sense frames.
        message: The firmware's message type; None for firmware without messages.
        stall: Deadlines.
        latency: Latency of the messages, in ticks; the same on all sides.
        silence_s: Wall seconds in ``gather`` after which the plant counts as lost although its token stands;
            None: as long as the token stands. A paused or compiling plant is silent too.
        wanted: Registers that the plant requests.
        cell_counters: Returns the cells' counters by name, reported as the shard leaves.
        keeps: Whether the plant may request snapshots.
        joins: Whether the shard joins a running simulation, at the tick that ``join`` returns.
        direct: Whether plain ticks may be stepped in a thread of the transport: steps always return soon.
        clock: Monotonic wall seconds.

    Attributes:
        counters: Payloads of this side so far.
        is_direct: Whether plain ticks are answered in a thread of the transport (``answer_directly``).
        drain_faults: Given a tick, returns the records of faults injected or repaired in it, or since the last call.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        partition: Partition,
        shard: int,
        form: WireFormat,
        *,
        run: str,
        readings: SensorSchema,
        message: np.dtype[Any] | None,
        stall: StallSpec | None = None,
        latency: BusSpec = NO_LATENCY,
        silence_s: float | None = None,
        wanted: Sequence[RegisterRequest] = (),
        cell_counters: Callable[[], Mapping[str, int]] = dict[str, int],
        keeps: bool = False,
        joins: bool = False,
        direct: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        wiring = RunSchema(run, partition, readings, message, latency)
        self._lookahead = wiring.lookahead
        self._endpoint = endpoint
        self._lattice = partition.lattice
        self._shard = shard
        self._stall = StallSpec() if stall is None else stall
        self._silence_s = silence_s
        self._clock = clock
        self._form: ParticipantCodec = FORMATS[form].participant(wiring, shard)
        self.counters = MessageCounters()
        self._tick = 0
        self._answer_until = 0.0
        self._known_changes, self._next_death = 0, NO_TICK_LIMIT
        """Changes of membership that the caller of ``gather`` has seen, and the next death in the shard."""
        self._plain_end = 0
        """First tick that may not be a plain one, unless something is handled before; see ``_is_plain``."""
        self._declared: list[str] = []
        lives = self._lives = Membership(len(partition.lattice))
        self._incoming = InboundFrames(wiring, shard, self._form, lives, self.counters)
        self._only_key = self._incoming.single_key
        self.is_direct = direct and wiring.lookahead == 0 and _is_small(self._form.layouts(0))
        self._outgoing = OutboundFrames(endpoint, wiring, shard, self._form, lives)
        self._membership = ParticipantMembership(
            partition.cells(shard), lives, self._incoming, self._outgoing, self.counters
        )
        if joins:
            self._incoming.accept_any_tick()
        token, control = plant_key(run, "alive"), plant_key(run, "control")
        self._control = ControlState(partition.lattice, self._membership, token, self.counters)
        self._control.joining = joins
        self.drain_faults: Callable[[int], list[Control]] = self._control.drain_faults
        self._inbox = Dispatcher(endpoint, partition, self.counters, self._control.handle_token)
        self._inbox.routes = {
            **self._incoming.subscribe(endpoint, self.is_direct),
            control: (self._control.handle, 0),
        }
        endpoint.subscribe(control, "urgent")
        self._reports = ReportPublisher(
            endpoint.publisher(shard_key(run, shard, "report")), self.counters, cell_counters
        )
        registers = endpoint.publisher(shard_key(run, shard, "registers"))
        self._registers = RegisterPublisher(registers, wanted, self.counters, clock)
        # The record is handled while the shard waits for the next tick.
        self._control.on_show = lambda: self._registers.show(self._tick - 1)
        self._snapshots: SnapshotPublisher | None = None
        if keeps:
            self._snapshots = SnapshotPublisher(
                endpoint.publisher(shard_key(run, shard, "snapshot")),
                self.counters,
                self._incoming.recorded_ticks,
            )
        endpoint.watch_alive(token)

    # --- the start ------------------------------------------------------------------------------

    def ready(self, deadline_s: float | None = None) -> None:
        """Declare the cells alive, wait until every receiver has subscribed, and declare the cells ready.

        Args:
            deadline_s: Wall seconds from now; None: ``stall.start_s``.

        Raises:
            BarrierError: The plant or a neighbour has not subscribed in time; names the keys.
            CoordinatorLostError: The plant is lost.
            WaitInterrupted: ``endpoint.wake`` was called.
        """
        limit = self._stall.start_s if deadline_s is None else deadline_s
        deadline = self._clock() + limit
        self._declare(self._form.alive_keys)
        waiting = {**self._outgoing.publishers, "report": self._reports.publisher}
        if self._registers.requests:
            waiting["registers"] = self._registers.publisher
        if self._snapshots is not None:
            waiting["snapshot"] = self._snapshots.publisher
        while True:
            waiting = {key: publisher for key, publisher in waiting.items() if not publisher.matched()}
            if not waiting and self._control.plant_seen:
                break
            left = deadline - self._clock()
            if left <= 0:
                keys = ", ".join(list(waiting)[:8])
                why = f"no subscriber for {keys}" if self._control.plant_seen else "the plant does not answer"
                raise BarrierError(f"shard {self._shard} is not ready after {limit:g} s: {why}")
            # No event tells of a match.
            self._inbox.poll(min(left, _POLL_S))
            if self._control.plant_lost:
                raise CoordinatorLostError("the plant left before the run began")
        self._declare(self._form.ready_keys)

    def join(self, deadline_s: float | None = None) -> int | None:
        """Wait, after ``ready``, for the shard's first tick in a running simulation.

        Args:
            deadline_s: Wall seconds from now; None: ``stall.start_s``.

        Returns:
            The first tick; None if the run was stopped before.

        Raises:
            BarrierError: The coordinator does not admit the shard in time.
            CoordinatorLostError: The plant is lost.
            WaitInterrupted: ``endpoint.wake`` was called.
        """
        limit = self._stall.start_s if deadline_s is None else deadline_s
        deadline = self._clock() + limit
        while self._control.rejoin_tick is None and self._control.stop is None:
            left = deadline - self._clock()
            if left <= 0:
                raise BarrierError(f"shard {self._shard} was not readmitted within {limit:g} s")
            self._inbox.poll(left)
            if self._control.plant_lost:
                raise CoordinatorLostError("the plant left before the shard could rejoin")
        return self._control.rejoin_tick

    def resume(self, tick: int, dead: Sequence[int], links: Sequence[MessageBytes]) -> None:
        """Resume at ``tick`` from another participant of the same shard; call before ``ready``.

        Args:
            tick: First tick to gather.
            dead: Indices in the lattice of the cells that had died before ``tick``.
            links: Messages that were on their way to the shard, from its snapshot.

        Raises:
            StateError: The messages are not those of the shard's links.
        """
        self._tick, self._control.resumed = tick, True
        if dead:
            self.mark_dead(dead, 0)
        if not self._membership.none_live(tick):
            self._incoming.resume(tick, links)

    def resumed(self) -> None:
        """Report the counters of a shard that resumes without a live cell; call once ready."""
        if self._membership.none_live(self._tick):
            self._reports.publish_counters(self._tick)

    def _declare(self, keys: Iterable[str]) -> None:
        for key in keys:
            self._endpoint.declare_alive(key)
            self._declared.append(key)

    # --- a tick ---------------------------------------------------------------------------------

    def gather(self, tick: int, timeout_s: float | None = None) -> TickInputs | Control | None:
        """Wait for the inputs of ``tick``.

        These are the tick's senses, and the link frames due in it of every neighbour that was live when they were sent.

        Args:
            tick: Must go up from call to call, except after None or WaitInterrupted.
            timeout_s: Longest wait, wall seconds; None: none.

        Returns:
            The inputs; or a ``stop`` record: the plant's, or the participant's own when no cell of the shard is live;
            or None after ``timeout_s``.

        Raises:
            CoordinatorLostError: The plant is lost, or was silent for ``silence_s``.
            WaitInterrupted: ``endpoint.wake`` was called; the call may be repeated.
        """
        # In a process of a single cell each call of a tick costs several times its usual time: nothing is in the
        # processor's caches by then.
        self._tick, self._plain_end = tick, 0
        control, membership = self._control, self._membership
        if control.rejoins_offered:
            control.rejoins_offered = [offer for offer in control.rejoins_offered if not self._offer(offer)]
        sense, links = self._incoming.slots(tick)
        until, limit = self._limits(timeout_s)
        read = self._inbox.poll
        while True:
            waits = sense.missing > 0
            missing = waits or (links is not None and links.missing > 0)
            if control.stop is not None:
                return control.stop
            if not self._lives.unchanged and membership.none_live(tick):
                # The token must not go before the report has come: the plant would take the cells' process for dead.
                left = self._answer_until - self._clock()
                if not control.unanswered or control.plant_lost or left <= 0:
                    return self._leave(tick)
                read(left, 1)
                continue
            if not missing:
                return self._collect(tick)
            if control.plant_lost:
                raise CoordinatorLostError(f"the plant left; shard {self._shard} waited for tick {tick}")
            left = None if limit is None else max(limit - self._clock(), 0.0)
            # Messages end no wait for senses. One that comes after the senses is waited for by its key.
            key = None if waits else self._incoming.awaited_key(tick)
            if not read(left, max(sense.missing, 1), key) and left == 0:
                if until == limit:
                    return None
                raise CoordinatorLostError(
                    f"the plant was silent for {self._silence_s:g} s; shard {self._shard} waited for tick {tick}"
                )

    def _leave(self, tick: int) -> Control:
        """Return the record with which a shard without live cells ends; publish what it has of a snapshot."""
        if self._snapshots is not None:
            self._snapshots.publish()
        return Control("stop", tick, (), "no cell of this shard is alive any more")

    def _collect(self, tick: int) -> TickInputs:
        """Return the inputs of a tick, which are all there."""
        membership, snapshots = self._membership, self._snapshots
        if snapshots is not None and tick + 1 == self._control.snapshot_tick:
            snapshots.record_counters(self._incoming.received_count(tick))
        if self._known_changes != membership.changes or tick >= self._next_death:
            self._known_changes = membership.changes
            self._next_death = membership.next_death(tick)
        inputs = self._incoming.collect(tick)
        if snapshots is not None:
            snapshots.record_links(inputs.links, self._incoming.parts_read)
        return inputs

    def _limits(self, timeout_s: float | None) -> tuple[float | None, float | None]:
        """Return the ends of the caller's wait, and of the wait by whatever ends first; None: never."""
        if timeout_s is None and self._silence_s is None:
            return None, None
        now = self._clock()
        until = None if timeout_s is None else now + timeout_s
        if self._silence_s is None:
            return until, until
        silent_until = now + self._silence_s
        return until, silent_until if until is None else min(until, silent_until)

    def _offer(self, joining: Control) -> bool:
        """Report that rejoining cells can be sent to; False if they can't yet."""
        cells = [self._lattice.index(cell) for cell in joining.cells]
        if not all(publisher.matched() for publisher in self._outgoing.publishers_to(cells)):
            return False
        self._reports.linked(joining.cells, self._tick)
        return True

    def publish(self, drive: DriveFrame, links: LinkFrame | None) -> None:
        """Send a tick's messages, then its drives; in the last live tick of the shard, report the counters first.

        A scheduled crash kills the process once its cells are dead: the counters would not arrive later.

        Args:
            drive: ``(n, 2)``, rows in the order of ``partition.cells(shard)``.
            links: In the order of ``partition.outgoing(shard)``; None where the firmware has no messages.

        Raises:
            BusError: A shape or type is not what was agreed, or a drive is not finite; names the cell.
        """
        puts = self._outgoing.encode(drive, links)
        self.counters.sent += len(puts)
        if not self._lives.unchanged and self._membership.none_live(drive.tick + 1):
            self._reports.publish_counters(self._tick)
        self._endpoint.put_all(puts)

    def confirmed(self, tick: int) -> bool:
        """Wait, after the shard's last live tick, until the plant has all that the shard sent before ``tick``.

        The plant's senses tell, which no longer concern the shard.

        Args:
            tick: First tick in which no cell of the shard is live.

        Returns:
            False if the run ends before.
        """
        counts = self.counters
        counted = (
            counts.delivered,
            counts.late,
        )  # what comes from now on is beyond the counters that were reported
        confirmed = self._incoming.newest_sense >= tick + self._lookahead
        while not confirmed and self._control.stop is None and not self._control.plant_lost:
            self._inbox.poll(None)
            confirmed = self._incoming.newest_sense >= tick + self._lookahead
        counts.delivered, counts.late = counted
        return confirmed

    # --- a tick in which nothing but its payload is handled ----------------------------------------

    def layouts(self, tick: int) -> tuple[PayloadLayout, PayloadLayout] | None:
        """Return the layouts of the shard's only payload each way in a tick; None where ``take_payload`` has none."""
        return self._incoming.single_layouts(tick)

    def take_payload(self, tick: int) -> bytes | None:
        """Wait for the sense payload of a tick, where the tick is like nearly all: nothing else is to be handled.

        Args:
            tick: As of ``gather``.

        Returns:
            The payload, to be answered by ``answer`` or handed back by ``gather_again``; None: call ``gather``.

        Raises:
            WaitInterrupted: ``endpoint.wake`` was called; the call may be repeated.
        """
        while (tick < self._plain_end and self._clock() < self._registers.next_look) or self._is_plain(tick):
            self._tick = tick
            payload = self._endpoint.receive_payload(self._only_key)
            if payload is not None:
                return payload
            if (payload := self._handle_others(tick, self._endpoint.receive_all(0.0))) is not None:
                return payload
        return None

    def _handle_others(self, tick: int, events: Sequence[Event]) -> bytes | None:
        """Handle events, but a single sense payload that came with others which leave the tick a plain one.

        Returns:
            That payload, as for ``take_payload``; None: all are handled.

        Raises:
            WaitInterrupted: There was a wakeup; all other events have been handled.
        """
        self._plain_end = 0
        own = [event for event in events if type(event) is Received and event.key == self._only_key]
        if len(own) != 1 or any(type(event) is Wakeup for event in events):
            self._inbox.handle(events)
            return None
        self._inbox.handle([event for event in events if event is not own[0]])
        if self._is_plain(tick):
            return own[0].payload
        self._inbox.handle(own)
        return None

    def answer(self, payload: bytes) -> None:
        """Publish the drive payload of the tick whose sense payload was taken last."""
        self._incoming.skip()
        self.counters.sent += 1
        self._outgoing.single.put(payload)

    def answer_directly(self, tick: int, step: Callable[[int, bytes], bytes | None]) -> None:
        """Have the payloads of plain ticks from ``tick`` on answered by ``step``, in a thread of the transport.

        Call it after ``answer``: what this thread has sent before has then left the process, so that an answer never
        waits in the transport for the thread that gives it. The call may return early.

        Args:
            tick: The next tick.
            step: From a tick and its senses to its drives; None: the payload is left for ``take_payload`` or
                ``gather``. Called while this call waits.
        """
        self._tick = tick

        def take(payload: bytes) -> bool:
            tick = self._tick
            if tick >= self._plain_end or self._clock() >= self._registers.next_look:
                return False
            drives = step(tick, payload)
            if drives is None:
                return False
            self.answer(drives)
            self._tick = tick + 1
            return True

        self._endpoint.answer_payloads(self._only_key, take)

    def gather_again(self, payload: bytes) -> None:
        """Hand a payload back, for ``gather`` to find."""
        self._plain_end = 0
        self._inbox.handle((Received(self._only_key, payload),))

    def _is_plain(self, tick: int) -> bool:
        """Whether a tick needs no more than its payload, as far as is known before it.

        So it is for all ticks before ``_plain_end``, until something is handled, or observers are looked for.
        """
        control = self._control
        is_plain = (
            self._known_changes == self._membership.changes
            and tick + 1 < self._next_death
            and self._silence_s is None
            and control.stop is None
            and not control.plant_lost
            and not control.rejoins_offered
            and control.snapshot_tick <= tick
            and not control.has_faults
            and self._registers.is_idle()
            and self._incoming.untouched(tick)
        )
        self._plain_end = self._next_death - 1 if is_plain else 0
        return is_plain

    def publish_snapshot(self, tick: int, read: Callable[[], bytes]) -> None:
        """Publish the shard's snapshot before ``tick`` if the plant requested one, with the messages under way to it.

        Call it after ``publish`` of the tick before.

        Args:
            tick: The next.
            read: Returns the state; called only if a snapshot was requested.
        """
        if tick == self._control.snapshot_tick and self._snapshots is not None:
            self._snapshots.begin(tick, read())

    def publish_registers(self, tick: int, read: Callable[[], Own]) -> None:
        """Publish the registers of the cells if the plant or another observer requests them.

        Call it before ``publish`` of the same tick: the plant then has the registers when it has the drives.

        Args:
            tick: The tick just computed.
            read: Returns rows and columns of the cells, ``(n, 2)``, and registers by name, arrays with a row a cell;
                called only if the registers are requested.
        """
        self._registers.publish(tick, read)

    def read_registers_by(self, read: Callable[[], Own]) -> None:
        """Have ``read`` return the registers for an observer that asks before a tick has published any."""
        self._registers.read = read

    # --- who takes part -------------------------------------------------------------------------

    def schedule_death(self, cells: Iterable[int], tick: int) -> None:
        """Schedule the permanent death of ``cells`` (indices in the lattice) at ``tick``."""
        self._plain_end = 0
        self._membership.schedule_death(cells, tick)

    def mark_dead(self, cells: Iterable[int], tick: int) -> None:
        """Mark ``cells`` (indices in the lattice) as dead from ``tick`` on; their process may rejoin."""
        self._plain_end = 0
        self._membership.mark_dead(cells, tick)

    @property
    def stopped(self) -> bool:
        """Whether the plant's stop record has come."""
        return self._control.stop is not None

    @property
    def unchanged(self) -> bool:
        """Whether no cell of the run ever died: masks of live cells can be skipped."""
        return self._lives.unchanged

    def live(self, tick: int) -> Mask:
        """Return the mask of the shard's cells that are live in ``tick``, ``(n,)``."""
        return self._membership.live(tick)

    def fail(self, cells: Iterable[int], tick: int, detail: str) -> None:
        """Report to the plant that ``cells`` (indices in the lattice) failed in ``tick``.

        Call it before ``publish`` of the same tick. The plant drops these cells; the others continue.
        """
        index = sorted(int(i) for i in cells)
        names = tuple(self._lattice.cells[i] for i in index)
        self._reports.failed(names, tick, detail)
        self._control.unanswered.update(index)
        self._answer_until = self._clock() + _ANSWER_S
        self.mark_dead(index, tick)

    def hang(self, cell: int, tick: int, detail: str) -> None:
        """Report to the plant that the program of ``cell`` (index in the lattice) hangs since ``tick``.

        The cell stays live. Call this before ``publish`` of that tick.
        """
        self._reports.hung(self._lattice.cells[cell], tick, detail)

    def busy(self, tick: int) -> None:
        """Report to the plant that the shard still computes ``tick``, which extends the deadline. From any thread."""
        self._reports.busy(tick)

    def hold(self, cell: tuple[int, int], tick: int) -> None:
        """Report to the plant that a debugger holds ``cell`` in ``tick``: deadlines are suspended. From any thread."""
        self._reports.held(cell, tick)

    def close(self) -> None:
        """Report the counters, wait until the plant that stopped the run is gone, and withdraw the tokens."""
        self._reports.publish_counters(self._tick)
        # Whoever closes a session may take with it what is still queued there: the report must have arrived before.
        deadline = self._clock() + _LEAVE_S
        while self._control.stop is not None and not self._control.plant_lost:
            left = deadline - self._clock()
            if left <= 0:
                break
            with contextlib.suppress(WaitInterrupted):
                self._inbox.poll(left)
        for key in reversed(self._declared):
            self._endpoint.withdraw(key)
        self._declared.clear()
