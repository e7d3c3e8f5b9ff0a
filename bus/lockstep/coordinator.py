"""The plant's side of the lockstep."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, Literal, final

import numpy as np

from bus.errors import BusError, WaitInterrupted, WireError
from bus.lockstep.counters import Loss, MessageCounters
from bus.lockstep.liveness import LivenessTracker
from bus.lockstep.membership import CoordinatorMembership
from bus.lockstep.receive import Dispatcher, FrameAssembler
from bus.lockstep.registers import RegisterReceiver, RegisterRequest, RegisterSnapshot
from bus.lockstep.reports import ReportReceiver
from bus.lockstep.snapshots import GlobalSnapshot, MessageBytes, SnapshotCollector, decode_snapshot
from bus.partition import Partition
from bus.sensors import SensorSchema
from bus.spec import NO_LATENCY, BusSpec, StallSpec
from bus.transports.base import Endpoint, Urgency
from bus.wire.format import CoordinatorCodec, RelayedLinks, RunSchema, relayed_links
from bus.wire.formats import FORMATS, WireFormat
from bus.wire.frames import (
    Control,
    DriveFrame,
    Mask,
    Report,
    SenseFrame,
    Values,
    check_sense,
    encode_control,
)
from bus.wire.keys import owner_of, plant_key, shard_key

_POLL_S: Final = 0.01
"""Polling interval for matches, which cause no event, wall seconds."""
_PATIENCE: Final = 9
"""Additional deadlines for a shard that reports ``busy``."""
_SLICE: Final = 0.125
"""Longest single wait, as a share of the deadline: a longer stop of this process itself doesn't count against cells."""
_BEFORE: Final = -1
"""In place of a tick: before the first. In place of a shard: all sides of a run before it was resumed."""


@final
class Coordinator:
    """Coordinator of the lockstep: publishes sense frames and gathers drive frames of all live cells.

    Blocking, one thread. It subscribes at once. The endpoint stays the caller's, to close later.

    Args:
        endpoint: The plant's endpoint.
        partition: Partition of the cells into shards; the same on all sides.
        form: Name of the wire format; the same on all sides.
        run: Name of the run.
        readings: Contents of sense frames.
        message: The firmware's message type; None for firmware without messages.
        wanted: Requests for registers of the cells.
        keeps: Whether snapshots may be requested.
        stall: Deadlines. The policy is the caller's to carry out on the losses that ``gather`` names.
        latency: Latency of the messages, in ticks; the same on all sides.
        clock: Monotonic wall seconds.

    Attributes:
        counters: Payloads of this side so far.
        lookahead: Ticks by which the caller may publish senses ahead of the drives that it gathers.
        unreported: Cells (indices) that were live at the end and whose shards' counters ``stop`` did not receive.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        partition: Partition,
        form: WireFormat,
        *,
        run: str,
        readings: SensorSchema,
        message: np.dtype[Any] | None,
        wanted: Sequence[RegisterRequest] = (),
        keeps: bool = False,
        stall: StallSpec | None = None,
        latency: BusSpec = NO_LATENCY,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._wiring = RunSchema(run, partition, readings, message, latency)
        self.lookahead = self._wiring.lookahead
        self._link_ticks = self._wiring.latency.link_ticks
        self._endpoint = endpoint
        self._stall = StallSpec() if stall is None else stall
        self._clock = clock
        self._form: CoordinatorCodec = FORMATS[form].coordinator(self._wiring)
        self.counters = MessageCounters()
        self.unreported: list[int] = []
        self._tick = 0
        self._sense = [endpoint.publisher(key) for key in self._form.sense_keys]
        self._control = endpoint.publisher(plant_key(run, "control"))
        self._closed = _BEFORE
        self._relayed: dict[int, RelayedLinks] = {}
        """Messages to pass on, by the tick in which they were sent."""
        self._roll = LivenessTracker(self._form, partition.lattice)
        self._drives = FrameAssembler(
            "drive",
            self._form.blank_drives,
            self._form.decode_drive,
            self.counters,
            self._form.batch,
            self._refuse_drive,
        )
        self._drives.latest = _BEFORE  # nobody can know what to drive before it has sensed
        self._inbox = Dispatcher(endpoint, partition, self.counters, self._roll.handle)
        for key, unit in self._form.drive_units.items():
            self._inbox.routes[key] = (self._drives.handle, unit)
        endpoint.subscribe(self._form.drive_expr)
        self._membership = CoordinatorMembership(
            partition,
            self._form,
            self._roll,
            self._drives,
            self.counters,
            matched=lambda unit: self._sense[unit].matched(),
            send=self.control,
        )
        self._reported = ReportReceiver(partition, lambda: self._tick, self._membership.rejoins.on_ready)
        self._subscribe_shards("report", self._reported.handle, "urgent")
        self._seen = RegisterReceiver(
            partition, wanted, self.counters, lambda: self._tick, lambda: self._drives.latest
        )
        if wanted:
            self._subscribe_shards("registers", self._seen.handle)
        self._keeping: SnapshotCollector | None = None
        if keeps:
            self._subscribe_shards("snapshot", self._handle_snapshot)
        endpoint.watch_alive(self._form.alive_expr)
        endpoint.watch_alive(self._form.ready_expr)
        self._alive_key = plant_key(run, "alive")
        endpoint.declare_alive(self._alive_key)

    def _subscribe_shards(
        self,
        leaf: Literal["report", "registers", "snapshot"],
        take: Callable[[int, bytes], None],
        haste: Urgency = "quiet",
    ) -> None:
        """Subscribe to a key of every shard."""
        run = self._wiring.run
        for shard in range(self._wiring.partition.count):
            self._inbox.routes[shard_key(run, shard, leaf)] = (take, shard)
        self._endpoint.subscribe(shard_key(run, None, leaf), haste)

    # --- the start ------------------------------------------------------------------------------

    def barrier(self, deadline_s: float | None = None) -> None:
        """Wait until every cell is ready and subscribed, then send the start record.

        Args:
            deadline_s: Wall seconds from now; None: ``stall.start_s``.

        Raises:
            BarrierError: Cells are missing; names the cells, and whether they ever appeared.
            WaitInterrupted: ``endpoint.wake`` was called.
        """
        limit = self._stall.start_s if deadline_s is None else deadline_s
        deadline = self._clock() + limit
        waiting = list(range(len(self._sense)))
        while True:
            everybody = self._roll.all_ready()
            if everybody:
                waiting = [unit for unit in waiting if not self._sense[unit].matched()]
                if not waiting:
                    break
            left = deadline - self._clock()
            if left <= 0:
                raise self._roll.missing(limit, waiting)
            # Tokens come as events, matches must be polled: they come with the tokens.
            self._inbox.poll(min(left, _POLL_S) if everybody else left)
        start = Control("start", self._tick)
        if _BEFORE in self._reported.counters:  # counted when the run began
            self._control.put(encode_control(start))
        else:
            self.control(start)

    def absent(self, timeout_s: float) -> set[int]:
        """Return the shards with a cell that has not appeared yet.

        Args:
            timeout_s: Wall seconds to wait for events first.
        """
        # Whoever wakes us wants what is happening already.
        with contextlib.suppress(WaitInterrupted):
            self._inbox.poll(timeout_s)
        return self._roll.absent(self._wiring.partition.shard_of)

    def resume(
        self,
        tick: int,
        dead: Sequence[int],
        counts: MessageCounters,
        relayed: Mapping[int, MessageBytes] | None = None,
    ) -> None:
        """Resume at ``tick`` from another coordinator of the same run; call before the barrier.

        Args:
            tick: First tick to publish and gather.
            dead: Indices of the cells that had died before ``tick``.
            counts: Counters of all sides before ``tick``.
            relayed: Messages to pass on, from the snapshot, by the tick in which they were sent.

        Raises:
            StateError: The messages are not those of the run's links.
        """
        self._tick, self._closed = tick, tick - 1
        self._relayed = {
            sent_in: relayed_links(self._wiring, one) for sent_in, one in (relayed or {}).items()
        }
        self._drives.start_at(tick)
        if dead:
            self.mark_dead(dead, 0)
        self._reported.counters[_BEFORE] = counts

    # --- a tick ---------------------------------------------------------------------------------

    def publish(self, frame: SenseFrame) -> None:
        """Send every live cell its senses.

        Raises:
            BusError: The frame is not what was agreed, or brings messages of a tick that was not gathered.
        """
        check_sense(frame, self._wiring.readings, len(self._wiring.partition.lattice))
        due = frame.tick - self._link_ticks
        if self._form.relays and self._closed < due:
            raise BusError(
                f"sense frame of tick {frame.tick}: brings the messages of tick {due}, whose drives must be gathered "
                f"first; the last gathered is {self._closed}"
            )
        puts = list(
            zip(self._sense, self._form.sense_payloads(frame, self._relayed.pop(due, None)), strict=True)
        )
        live = len(puts)
        if not self._membership.unchanged:
            # A dead cell's process learns from senses that its last drive has arrived: see Participant.confirmed. It
            # has those of its first dead tick; ahead of the drives it takes more of them. A run that goes on from a
            # checkpoint has no such process, so these are not counted.
            ends = self._drives.end_tick
            last = frame.tick - (self.lookahead + 1 if self.lookahead else 0)
            puts = [put for put, until in zip(puts, ends, strict=True) if until > last]
            live = sum(until > frame.tick for until in ends)
        self._drives.latest = frame.tick
        self._endpoint.put_all(puts)
        self.counters.sent += live

    def gather(self, tick: int) -> tuple[DriveFrame, list[Loss]]:
        """Wait until every expected drive for ``tick`` has arrived or its cell has been dropped.

        A cell is dropped after ``stall.deadline_s``; a shard that keeps reporting ``busy`` gets ten times as long.
        No deadline runs while a debugger holds a cell, nor while this process itself doesn't run (it is stopped, or its
        host suspended): the cells may not have run either, and their drives may wait in its sockets.

        Args:
            tick: Must go up from call to call; at most ``lookahead`` behind the senses that were published last.

        Returns:
            The drives ``(n, 2)``, zero for dead cells, and the cells lost at this tick, ascending. The losses have been
            announced to all shards.

        Raises:
            WaitInterrupted: ``endpoint.wake`` was called; the call may be repeated.
        """
        self._tick = tick
        slot = self._drives.slot(tick)
        read, clock = self._inbox.poll, self._clock
        deadline = clock() + self._stall.deadline_s
        latest = deadline + _PATIENCE * self._stall.deadline_s
        longest = _SLICE * self._stall.deadline_s
        while True:
            if self._roll.unhandled_departures or self._reported.failed:
                self._membership.drop_failed(tick, self._reported.drain_failed())
                self._membership.drop_disconnected(tick, slot.have)
            if slot.missing <= 0 and self._drives.settle():
                break
            begun = clock()
            wait = min(max(deadline - begun, 0.0), longest)
            came = read(wait, slot.missing)
            now = clock()
            if (overslept := now - begun - wait) > longest:
                deadline += overslept
                latest += overslept
            if not came and now >= deadline:
                self._drives.settle()
                if self._reported.drain_held(tick):
                    deadline = now + self._stall.deadline_s
                    latest = deadline + _PATIENCE * self._stall.deadline_s
                    continue
                self._membership.drop_timed_out(tick, self._reported.drain_busy(tick) if now < latest else ())
                deadline = min(now + self._stall.deadline_s, latest)
        return DriveFrame(tick, self._close(tick)), self._membership.drain_losses()

    def _refuse_drive(self, unit: int, error: WireError) -> None:
        key = next(key for key, named in self._form.drive_units.items() if named == unit)
        self.counters.refuse(error, owner_of(key, self._wiring.partition))

    def _close(self, tick: int) -> Values:
        """Close a tick whose drives have been gathered: return the drives, and store the messages to pass on."""
        values = self._drives.close(tick).values
        self._closed = tick
        live = None if self._membership.unchanged else self._membership.live(tick)
        if self._form.relays:
            self._relayed[tick] = self._form.relay(values, live)
        drive = self._form.join_drives(values)
        if live is not None:
            drive[~live] = 0.0
        return drive

    def awaited(self) -> list[int]:
        """Return the shards whose drives of the next tick to gather have not arrived; from any thread."""
        shard_of, cells = self._wiring.partition.shard_of, self._form.unit_cells
        return sorted({int(shard_of[int(cells[unit][0])]) for unit in self._drives.awaited()})

    # --- who takes part -------------------------------------------------------------------------

    def mark_dead(self, cells: Iterable[int], tick: int) -> None:
        """Mark ``cells`` (indices) as dead from ``tick`` on: a scheduled death, which is no loss."""
        self._membership.mark_dead(cells, tick)

    def live(self, tick: int) -> Mask:
        """Return the mask of cells that are live in ``tick``, ``(n,)``."""
        return self._membership.live(tick)

    def admit(self, tick: int) -> list[int]:
        """Readmit cells whose process was replaced and is ready; call between two ticks.

        Args:
            tick: The next.

        Returns:
            Indices of the readmitted cells, ascending. Their drives are expected from ``tick`` on, and the rejoin has
            been announced to all shards.

        Raises:
            WaitInterrupted: ``endpoint.wake`` was called.
        """
        if self._membership.rejoins:
            self._inbox.poll(0.0)  # while no cell is live, nothing else reads what arrives
        return self._membership.admit(tick)

    # --- what shards remember and show ----------------------------------------------------------

    def request_snapshot(self, tick: int) -> None:
        """Request snapshots of all shards before ``tick``; call before ``publish`` of the previous tick."""
        self._control.put(encode_control(Control("snapshot", tick)))
        self._keeping = SnapshotCollector(tick, self._membership.shards(tick - 1))

    def record_snapshot(self) -> None:
        """Record the coordinator's part of the requested snapshot.

        Call when its tick is about to begin, and all drives before it have been gathered.
        """
        assert self._keeping is not None
        live = self._membership.shards(self._keeping.tick - 1)
        self._keeping.record(self.counters, self._relayed, live)

    def poll_snapshot(self) -> GlobalSnapshot | None:
        """Return the global snapshot once all requested shards have answered, else None."""
        together = None if self._keeping is None else self._keeping.combined(self._reported.counters)
        if together is not None:
            self._keeping = None
        return together

    def cancel_snapshot(self) -> list[int]:
        """Cancel the snapshot in progress; return the shards that have not answered."""
        keeping, self._keeping = self._keeping, None
        return [] if keeping is None else keeping.missing

    def _handle_snapshot(self, shard: int, payload: bytes) -> None:
        snapshot = decode_snapshot(payload, len(self._wiring.partition.cells(shard)))
        if self._keeping is not None:  # else it comes too late
            self._keeping.handle(shard, snapshot)

    def drain_hung(self) -> list[Report]:
        """Return reports of programs that hung since the last call; the cells of these programs stay live."""
        return self._reported.drain_hung()

    def show_registers(self) -> None:
        """Have all shards publish their registers once more, for observers; call between two ticks."""
        last = self._drives.latest
        self._seen.show(last)
        self._control.put(encode_control(Control("show", max(last, 0))))

    def drain_registers(self) -> list[RegisterSnapshot]:
        """Return register snapshots since the last call; a tick's snapshot is complete once its drives are gathered."""
        return self._seen.drain()

    # --- to all ---------------------------------------------------------------------------------

    def control(self, record: Control) -> None:
        """Send a control record to all shards."""
        self._control.put(encode_control(record))
        self.counters.sent += len(self._membership.shards(self._tick))

    def stop(self, detail: str = "", deadline_s: float = 2.0) -> MessageCounters:
        """Stop the run: send the stop record, wait for counters, withdraw the token, and wait for the cells' tokens.

        A cell keeps its session open until the plant's token is withdrawn, as payloads queued in a closing session are
        lost.

        Args:
            detail: Why, for the cells' logs.
            deadline_s: Wall seconds to wait.

        Returns:
            The counters of all sides: the coordinator's own, and the shards' final reports.
        """
        self.control(Control("stop", self._tick, (), detail))
        counts = self._reported.counters
        shards = self._membership.shards(self._tick)
        deadline = self._clock() + deadline_s
        self._read_until(lambda: counts.keys() >= set(shards), deadline)
        self.close()
        self._read_until(lambda: not self._roll.alive, deadline)
        cells = self._wiring.partition.cells
        self.unreported = sorted(i for s in shards if s not in counts for i in cells(s).tolist())
        return sum(counts.values(), self.counters)

    def _read_until(self, done: Callable[[], bool], deadline: float) -> None:
        while not done() and (left := deadline - self._clock()) > 0:
            # Whoever wakes us wants what is happening already.
            with contextlib.suppress(WaitInterrupted):
                self._inbox.poll(left)

    def close(self) -> None:
        """Withdraw the plant's token; participants take this for the end of the plant."""
        self._endpoint.withdraw(self._alive_key)
