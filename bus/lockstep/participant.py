"""The cells' side of the lockstep: one shard."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Final, final

import numpy as np

from bus.errors import BarrierError, CoordinatorLostError, WaitInterrupted
from bus.lockstep.control import ControlState
from bus.lockstep.counters import MessageCounters
from bus.lockstep.intervals import Membership
from bus.lockstep.receive import Dispatcher
from bus.lockstep.registers import Own, RegisterPublisher, RegisterRequest
from bus.lockstep.reports import ReportPublisher
from bus.lockstep.shard_io import InboundFrames, OutboundFrames, ParticipantMembership, TickInputs
from bus.lockstep.snapshots import SnapshotPublisher
from bus.partition import Partition
from bus.sensors import SensorSchema
from bus.spec import StallSpec
from bus.transports.base import Endpoint
from bus.wire.format import ParticipantCodec, RunSchema
from bus.wire.formats import FORMATS, WireFormat
from bus.wire.frames import Control, DriveFrame, LinkFrame, Mask
from bus.wire.keys import plant_key, shard_key

_POLL_S: Final = 0.01
_LINK_POLL_S: Final = 0.001
_ANSWER_S: Final = 1.0
_LEAVE_S: Final = 5.0
"""For how long to wait, when the run is over, for the plant to take the counts."""
"""Wall seconds that a shard whose cells have all failed stays for the plant's answer."""
"""How often to look for messages where they come after the senses, as no cell of ours sends them."""


@final
class Participant:
    """Gathers what a shard's cells sense and hear, and publishes what they drive and say.

    Blocking; one thread at a time, but ``publish`` may be called from another while ``gather`` waits for the tick
    after. It subscribes at once. The endpoint stays the caller's, to close later.

    Args:
        endpoint: The endpoint of the shard's process.
        partition: How the cells are cut into shards; the same on all sides.
        shard: Which of them this is.
        form: ``"packed"`` or ``"cells"``; the same on all sides.
        run: Name of the run.
        readings: What sense frames carry.
        message: The firmware's message type, None where cells send each other nothing.
        stall: Deadlines.
        silence_s: Wall seconds in ``gather`` after which the plant counts as lost although its token stands;
            None: as long as the token stands. A paused or compiling plant is silent too.
        wanted: Registers of the cells that the plant wants to see.
        tally: What else to report as the shard leaves: numbers that the cells counted, by name.
        keeps: Whether the plant may ask what the shard remembers.
        joins: Whether it comes into a run that goes on already: it takes part once ``join`` says so.
        clock: Monotonic wall seconds.

    Attributes:
        counts: Payloads of this side so far.
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
        silence_s: float | None = None,
        wanted: Sequence[RegisterRequest] = (),
        tally: Callable[[], Mapping[str, int]] = dict[str, int],
        keeps: bool = False,
        joins: bool = False,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        wiring = RunSchema(run, partition, readings, message)
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
        self._declared: list[str] = []
        lives = Membership(len(partition.lattice))
        self._incoming = InboundFrames(wiring, shard, self._form, lives, self.counters)
        self._outgoing = OutboundFrames(endpoint, wiring, shard, self._form, lives)
        self._company = ParticipantMembership(
            partition.cells(shard), lives, self._incoming, self._outgoing, self.counters
        )
        if joins:
            self._incoming.accept_any_tick()
        token, control = plant_key(run, "alive"), plant_key(run, "control")
        self._told = ControlState(partition.lattice, self._company, token, self.counters)
        self._inbox = Dispatcher(endpoint, self.counters, self._told.handle_token)
        self._inbox.routes = {**self._incoming.subscribe(endpoint), control: (self._told.handle, 0)}
        endpoint.subscribe(control, "urgent")
        self._reports = ReportPublisher(
            endpoint.publisher(shard_key(run, shard, "report")), self.counters, tally
        )
        registers = endpoint.publisher(shard_key(run, shard, "registers"))
        self._showing = RegisterPublisher(registers, wanted, self.counters, clock)
        self._remembering: SnapshotPublisher | None = None
        if keeps:
            self._remembering = SnapshotPublisher(
                endpoint.publisher(shard_key(run, shard, "memory")), self.counters
            )
        endpoint.watch_alive(token)

    # --- the start ------------------------------------------------------------------------------

    def ready(self, deadline_s: float | None = None) -> None:
        """Shows that the cells are here, waits until all whom they talk to listen, and says they are ready.

        Args:
            deadline_s: Wall seconds from now; None: ``stall.start_s``.

        Raises:
            BarrierError: The plant or a neighbour does not listen in time; names the keys.
            HostLostError: The plant went away.
            WokenError: ``endpoint.wake`` was called.
        """
        limit = self._stall.start_s if deadline_s is None else deadline_s
        deadline = self._clock() + limit
        self._declare(self._form.alive_keys)
        waiting = {**self._outgoing.publishers, "report": self._reports.publisher}
        if self._showing.requests:
            waiting["registers"] = self._showing.publisher
        if self._remembering is not None:
            waiting["memory"] = self._remembering.publisher
        while True:
            waiting = {key: publisher for key, publisher in waiting.items() if not publisher.matched()}
            if not waiting and self._told.plant_seen:
                break
            left = deadline - self._clock()
            if left <= 0:
                keys = ", ".join(list(waiting)[:8])
                why = f"nobody listens to {keys}" if self._told.plant_seen else "the plant does not answer"
                raise BarrierError(f"shard {self._shard} is not ready after {limit:g} s: {why}")
            # No event tells of a match.
            self._inbox.poll(min(left, _POLL_S))
            if self._told.plant_lost:
                raise CoordinatorLostError("the plant left before the run began")
        self._declare(self._form.ready_keys)

    def join(self, deadline_s: float | None = None) -> int | None:
        """Waits, after ``ready``, for the tick from which the shard takes part in a run that goes on already.

        Args:
            deadline_s: Wall seconds from now; None: ``stall.start_s``.

        Returns:
            That tick; None: the run was stopped before.

        Raises:
            BarrierError: Nobody lets it take part in time.
            HostLostError: The plant went away.
            WokenError: ``endpoint.wake`` was called.
        """
        limit = self._stall.start_s if deadline_s is None else deadline_s
        deadline = self._clock() + limit
        while self._told.rejoin_tick is None and self._told.stop is None:
            left = deadline - self._clock()
            if left <= 0:
                raise BarrierError(f"shard {self._shard} was not let in within {limit:g} s")
            self._inbox.poll(left)
            if self._told.plant_lost:
                raise CoordinatorLostError("the plant left before the shard could take part")
        return self._told.rejoin_tick

    def resume(self, tick: int, dead: Sequence[int]) -> None:
        """Goes on at ``tick`` where another side of the same shard was; before ``ready``.

        Args:
            tick: The first to be gathered.
            dead: Indices in the lattice of the cells that had gone before it.
        """
        self._tick, self._told.resumed = tick, True
        self._incoming.resume(tick)
        if dead:
            self.mark_dead(dead, 0)

    def resend_links(self, links: LinkFrame | None) -> None:
        """Sends the messages of the tick before the first again, which that side had sent and counted; once ready.

        Args:
            links: Those messages; None where the firmware has none.
        """
        if links is not None:
            self._endpoint.put_all(self._outgoing.encode_links(links))
        if self._company.none_live(self._tick):
            self._reports.publish_counters(self._tick)

    def _declare(self, keys: Iterable[str]) -> None:
        for key in keys:
            self._endpoint.declare_alive(key)
            self._declared.append(key)

    # --- a tick ---------------------------------------------------------------------------------

    def gather(self, tick: int) -> TickInputs | Control:
        """Waits for what the shard needs to compute ``tick``.

        That is the tick's senses, and the link frame of the tick before from every neighbour that lived then.

        Args:
            tick: Must go up from call to call.

        Returns:
            That; or a ``stop`` record: the plant's, or this side's own when no cell of the shard takes part.

        Raises:
            HostLostError: The plant went away, or was silent for ``silence_s``.
            WokenError: ``endpoint.wake`` was called; the call may be repeated.
        """
        self._tick = tick
        told, company = self._told, self._company
        if told.rejoins_offered:
            told.rejoins_offered = [control for control in told.rejoins_offered if not self._offer(control)]
        sense, links = self._incoming.slots(tick)
        deadline = None if self._silence_s is None else self._clock() + self._silence_s
        read = self._inbox.poll
        while True:
            waits = sense.missing > 0
            missing = waits or (links is not None and links.missing > 0)
            if told.stop is not None:
                return told.stop
            if company.none_live(tick):
                # The token must not go before the report has come: the plant would take the cells' process for dead.
                left = self._answer_until - self._clock()
                if not told.unanswered or told.plant_lost or left <= 0:
                    return Control("stop", tick, (), "no cell of this shard takes part any more")
                read(left, 1)
                continue
            if not missing:
                if tick + 1 == told.snapshot_tick and self._remembering is not None:
                    self._remembering.record_counters(self._incoming.received_count(tick))
                return self._incoming.collect(tick)
            if told.plant_lost:
                raise CoordinatorLostError(f"the plant left; shard {self._shard} waited for tick {tick}")
            left = None if deadline is None else max(deadline - self._clock(), 0.0)
            if not waits:
                # Messages after the senses wake nobody.
                left = _LINK_POLL_S if left is None else min(left, _LINK_POLL_S)
            if not read(left, max(sense.missing, 1)) and left == 0:
                raise CoordinatorLostError(
                    f"the plant was silent for {self._silence_s:g} s; shard {self._shard} waited for tick {tick}"
                )

    def drain_faults(self) -> list[Control]:
        """Faults that somebody injected or repaired since the last call; they act from the tick gathered last on."""
        return self._told.drain_faults()

    def _offer(self, joining: Control) -> bool:
        """Tells the plant that cells that come back can be sent to, if they can."""
        cells = [self._lattice.index(cell) for cell in joining.cells]
        if not all(publisher.matched() for publisher in self._outgoing.publishers_to(cells)):
            return False
        self._reports.linked(joining.cells, self._tick)
        return True

    def publish(self, drive: DriveFrame, links: LinkFrame | None) -> None:
        """Sends a tick's messages, then its drives; before the last that any cell of the shard drives, the counts.

        They would not arrive if the process were killed when its cells are dead, as a scheduled crash does.

        Args:
            drive: ``(n, 2)``, rows in the order of ``partition.cells(shard)``.
            links: In the order of ``partition.outgoing(shard)``; None where the firmware has no messages.

        Raises:
            BusError: A shape or type is not what was agreed, or a drive is not finite; names the cell.
        """
        puts = self._outgoing.encode(drive, links)
        self.counters.sent += len(puts)
        if self._company.none_live(drive.tick + 1):
            self._reports.publish_counters(self._tick)
        self._endpoint.put_all(puts)

    def publish_snapshot(self, tick: int, read: Callable[[], bytes]) -> None:
        """Tells the plant what the shard remembers before ``tick``, if it has asked.

        Call it after ``publish`` of the tick before.

        Args:
            tick: The next.
            read: Gives the state; asked only where the plant has.
        """
        if tick == self._told.snapshot_tick and self._remembering is not None:
            self._remembering.publish(tick, read())

    def publish_registers(self, tick: int, read: Callable[[], Own]) -> None:
        """Puts the registers of the cells, if the plant or somebody else wants to see them.

        Call it before ``publish`` of that tick: then the plant has them when it has its drives.

        Args:
            tick: That they have computed.
            read: Gives who they are, ``(n, 2)`` row and column, and their registers by name, arrays with a row for
                each; asked only where somebody wants to see.
        """
        self._showing.publish(tick, read)

    # --- who takes part -------------------------------------------------------------------------

    def schedule_death(self, cells: Iterable[int], tick: int) -> None:
        """Nobody waits for ``cells`` (indices in the lattice) from ``tick`` on: a scheduled death."""
        self._company.schedule_death(cells, tick)

    def mark_dead(self, cells: Iterable[int], tick: int) -> None:
        """Nobody waits for ``cells`` (indices in the lattice) from ``tick`` on; their process may come back."""
        self._company.mark_dead(cells, tick)

    def live(self, tick: int) -> Mask:
        """``(n,)``: the shard's cells that take part in ``tick``."""
        return self._company.live(tick)

    def fail(self, cells: Iterable[int], tick: int, detail: str) -> None:
        """Tells the plant that ``cells`` (indices in the lattice) can't do ``tick``.

        Call it before ``publish`` of that tick. The plant gives them up as failed; the others go on.
        """
        index = sorted(int(i) for i in cells)
        names = tuple(self._lattice.cells[i] for i in index)
        self._reports.failed(names, tick, detail)
        self._told.unanswered.update(index)
        self._answer_until = self._clock() + _ANSWER_S
        self.mark_dead(index, tick)

    def hang(self, cell: int, tick: int, detail: str) -> None:
        """Tells the plant that the program of ``cell`` (index in the lattice) hangs since ``tick``; the cell goes on.

        Call it before ``publish`` of that tick.
        """
        self._reports.hung(self._lattice.cells[cell], tick, detail)

    def busy(self, tick: int) -> None:
        """Tells the plant that the shard still computes ``tick``: it waits for longer. From any thread."""
        self._reports.busy(tick)

    def close(self) -> None:
        """Reports this side's counts and, once the plant that stopped the run has taken them, takes the tokens back."""
        self._reports.publish_counters(self._tick)
        # Whoever closes a session may take with it what is still queued there: the report must have arrived before.
        deadline = self._clock() + _LEAVE_S
        while self._told.stop is not None and not self._told.plant_lost:
            left = deadline - self._clock()
            if left <= 0:
                break
            with contextlib.suppress(WaitInterrupted):
                self._inbox.poll(left)
        for key in reversed(self._declared):
            self._endpoint.withdraw(key)
        self._declared.clear()
