"""The cells' side of the lockstep: one shard."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any, Final, NamedTuple, final

import numpy as np

from bus import wire
from bus.counts import Counts
from bus.errors import BarrierError, BusError, HostLostError, WireError, WokenError
from bus.forms import FORMS, FormName
from bus.forms.form import MemberForm, Wiring
from bus.host import EARLY_TICKS, NEVER
from bus.keys import plant_key, shard_key
from bus.partition import Partition
from bus.specs import StallSpec
from bus.transport import Alive, Endpoint, Event, Received
from bus.wire import Control, DriveFrame, LinkFrame, Report, SenseFrame

_POLL_S: Final = 0.01


class Gathered(NamedTuple):
    """What a shard computes a tick from.

    Attributes:
        sense: Of this tick; rows in the order of ``partition.cells(shard)``, false and zero for cells that
            are gone.
        links: What the links of ``partition.incoming(shard)`` brought, sent in the tick before: ``tick - 1``.
            At tick 0 nothing was sent. None where the firmware has no messages.
    """

    sense: SenseFrame
    links: LinkFrame | None


class _Sense:
    """Sense of one tick, as far as it has come."""

    __slots__ = ("encoder_m", "have", "presence")

    def __init__(self, presence: wire.Mask, encoder_m: wire.Values | None, units: int) -> None:
        self.presence = presence
        self.encoder_m = encoder_m
        self.have = np.zeros(units, dtype=np.bool_)


class _Links:
    """Link frames of one tick, as far as they have come."""

    __slots__ = ("have", "message", "sent")

    def __init__(self, links: int, message: np.dtype[Any], parts: int) -> None:
        self.sent = np.zeros(links, dtype=np.bool_)
        self.message = np.zeros(links, dtype=message)
        self.have = np.zeros(parts, dtype=np.bool_)


@final
class Member:
    """Gathers what a shard's cells sense and hear, and publishes what they drive and say.

    Blocking; one thread at a time. It subscribes at once. The endpoint stays the caller's, to close later.

    Args:
        endpoint: The endpoint of the shard's process.
        partition: How the cells are cut into shards; the same on all sides.
        shard: Which of them this is.
        form: ``"packed"`` or ``"cells"``; the same on all sides.
        run: Name of the run.
        sensors: Presence sensors a cell.
        encoders: Whether sense frames carry encoder travel.
        message: The firmware's message type, None where cells send each other nothing.
        stall: Deadlines.
        silence_s: Wall seconds in ``gather`` after which the plant counts as lost although its token stands;
            None: as long as the token stands. A paused or compiling plant is silent too.
        clock: Monotonic wall seconds.

    Attributes:
        counts: Payloads of this side so far.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        partition: Partition,
        shard: int,
        form: FormName,
        *,
        run: str,
        sensors: int,
        encoders: bool,
        message: np.dtype[Any] | None,
        stall: StallSpec | None = None,
        silence_s: float | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        wiring = Wiring(run, partition, sensors, encoders, message)
        self._endpoint = endpoint
        self._partition = partition
        self._shard = shard
        self._stall = StallSpec() if stall is None else stall
        self._silence_s = silence_s
        self._clock = clock
        self._sensors = sensors
        self._encoders = encoders
        self._message = wiring.message
        self._form: MemberForm = FORMS[form].member(wiring, shard)
        self.counts = Counts()
        self._cells = partition.cells(shard)
        self._incoming = len(partition.incoming(shard))
        self._outgoing = len(partition.outgoing(shard))
        self._until = np.full(len(partition.lattice), NEVER, dtype=np.int64)
        self._all_live = True
        self._recount()
        self._tick = 0
        self._senses: dict[int, _Sense] = {}
        self._links: dict[int, _Links] = {}
        self._stop: Control | None = None
        self._plant_seen = False
        self._plant_lost = False
        self._declared: list[str] = []
        self._control_key = plant_key(run, "control")
        self._plant_key = plant_key(run, "alive")
        for key in (*self._form.sense_units, *self._form.in_parts, self._control_key):
            endpoint.subscribe(key)
        self._drive = [endpoint.publisher(key) for key in self._form.drive_keys]
        self._out = [endpoint.publisher(key) for key in self._form.out_keys]
        self._report = endpoint.publisher(shard_key(run, shard, "report"))
        endpoint.watch_alive(self._plant_key)

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
        self._show(self._form.alive_keys)
        names = (*self._form.drive_keys, *self._form.out_keys, "report")
        publishers = (*self._drive, *self._out, self._report)
        waiting = dict(zip(names, publishers, strict=True))
        while True:
            waiting = {key: publisher for key, publisher in waiting.items() if not publisher.matched()}
            if not waiting and self._plant_seen:
                break
            left = deadline - self._clock()
            if left <= 0:
                keys = ", ".join(list(waiting)[:8])
                why = f"nobody listens to {keys}" if self._plant_seen else "the plant does not answer"
                raise BarrierError(f"shard {self._shard} is not ready after {limit:g} s: {why}")
            # No event tells of a match.
            event = self._endpoint.receive(min(left, _POLL_S))
            if event is not None:
                self._take(event)
            if self._plant_lost:
                raise HostLostError("the plant left before the run began")
        self._show(self._form.ready_keys)

    def _show(self, keys: Iterable[str]) -> None:
        for key in keys:
            self._endpoint.declare_alive(key)
            self._declared.append(key)

    # --- a tick ---------------------------------------------------------------------------------

    def gather(self, tick: int) -> Gathered | Control:
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
        sense = self._sense_slot(tick)
        links = None if self._message is None else self._link_slot(tick - 1)
        deadline = None if self._silence_s is None else self._clock() + self._silence_s
        receive = self._endpoint.receive
        while True:
            if self._stop is not None:
                return self._stop
            if not self._all_live and not self.live(tick).any():
                return Control("stop", tick, (), "no cell of this shard takes part any more")
            if self._complete(sense, links, tick):
                break
            if self._plant_lost:
                raise HostLostError(f"the plant left; waited for tick {tick}")
            event = receive(None if deadline is None else max(deadline - self._clock(), 0.0))
            if event is not None:
                self._take(event)
            elif deadline is not None and self._clock() >= deadline:
                raise HostLostError(f"the plant was silent for {self._silence_s:g} s; waited for tick {tick}")
        return self._hand_over(sense, links, tick)

    def _complete(self, sense: _Sense, links: _Links | None, tick: int) -> bool:
        if self._all_live:
            return bool(sense.have.all() and (links is None or tick == 0 or links.have.all()))
        if not (sense.have | (self._unit_until <= tick)).all():
            return False
        return links is None or tick == 0 or bool((links.have | (self._source_until <= tick - 1)).all())

    def _hand_over(self, sense: _Sense, links: _Links | None, tick: int) -> Gathered:
        for slots in (self._senses, self._links):
            for over in [t for t in slots if t < tick]:
                del slots[over]
        self._senses.pop(tick, None)
        self._tick = tick + 1
        if not self._all_live:
            gone = ~self.live(tick)
            sense.presence[gone] = False
            if sense.encoder_m is not None:
                sense.encoder_m[gone] = 0.0
        frame = None if links is None else LinkFrame(tick - 1, links.sent, links.message)
        return Gathered(SenseFrame(tick, sense.presence, sense.encoder_m), frame)

    def publish(self, drive: DriveFrame, links: LinkFrame | None) -> None:
        """Sends a tick's messages, then its drives.

        Args:
            drive: ``(n, 2)``, rows in the order of ``partition.cells(shard)``.
            links: In the order of ``partition.outgoing(shard)``; None where the firmware has no messages.

        Raises:
            BusError: A shape or type is not what was agreed, or a drive is not finite; names the cell.
        """
        self._check(drive, links)
        tick = drive.tick
        live = None if self._all_live else self._until
        # Messages first: when the plant has the drives, it has passed the messages on.
        if links is not None and self._out:
            if live is not None:
                links = self._without_the_dead(links)
            for i, payload in enumerate(self._form.link_payloads(links)):
                if live is None or (self._out_until[i] > tick and self._target_until[i] > tick + 1):
                    self._out[i].put(payload)
                    self.counts.sent += 1
        for i, payload in enumerate(self._form.drive_payloads(drive)):
            if live is None or self._unit_until[i] > tick:
                self._drive[i].put(payload)
                self.counts.sent += 1

    def _check(self, drive: DriveFrame, links: LinkFrame | None) -> None:
        values = drive.drive
        if values.shape != (len(self._cells), 2) or values.dtype != np.float64:
            raise BusError(
                f"drive of shard {self._shard}, tick {drive.tick}: must be float64 {(len(self._cells), 2)}, "
                f"is {values.dtype} {values.shape}"
            )
        if not np.isfinite(values).all():
            i = int(np.nonzero(~np.isfinite(values).all(axis=1))[0][0])
            row, column = self._partition.lattice.cells[int(self._cells[i])]
            raise BusError(
                f"drive of cell {row},{column}, tick {drive.tick}: must be finite, is {values[i].tolist()}"
            )
        if (links is None) != (self._message is None):
            raise BusError(
                f"links of shard {self._shard}: the firmware {'has' if links is None else 'has no'} messages"
            )
        if links is not None and not (
            links.tick == drive.tick
            and links.sent.shape == links.message.shape == (self._outgoing,)
            and links.message.dtype == self._message
        ):
            raise BusError(
                f"links of shard {self._shard}, tick {drive.tick}: must be {self._outgoing} of {self._message}"
                f", are {links.message.shape} of {links.message.dtype} of tick {links.tick}"
            )

    def _without_the_dead(self, links: LinkFrame) -> LinkFrame:
        sources = self._partition.outgoing(self._shard).source
        return LinkFrame(links.tick, links.sent & (self._until[sources] > links.tick), links.message)

    # --- who takes part -------------------------------------------------------------------------

    def retire(self, cells: Iterable[int], tick: int) -> None:
        """Nobody waits for ``cells`` (indices in the lattice) from ``tick`` on: a scheduled death."""
        index = np.fromiter(cells, dtype=np.int64)
        self._until[index] = np.minimum(self._until[index], tick)
        self._all_live = False
        self._recount()

    def live(self, tick: int) -> wire.Mask:
        """``(n,)``: the shard's cells that take part in ``tick``."""
        return self._until[self._cells] > tick

    def fail(self, cells: Iterable[int], tick: int, detail: str) -> None:
        """Tells the plant that ``cells`` (indices in the lattice) can't do ``tick``.

        Call it before ``publish`` of that tick. The plant gives them up as failed; the others go on.
        """
        index = sorted(int(i) for i in cells)
        names = tuple(self._partition.lattice.cells[i] for i in index)
        self._report.put(wire.encode_report(Report("failed", tick, names, detail)))
        self.counts.sent += 1
        self.retire(index, tick)

    def close(self) -> None:
        """Reports this side's counts and takes the tokens back."""
        counts = self.counts
        report = Report(
            "counts", self._tick, (), "", (counts.sent, counts.delivered, counts.lost, counts.late)
        )
        self._report.put(wire.encode_report(report))
        for key in reversed(self._declared):
            self._endpoint.withdraw(key)
        self._declared.clear()

    def _recount(self) -> None:
        form, until = self._form, self._until

        def last(cells: Iterable[Any]) -> Any:
            return np.array([until[index].max() for index in cells], dtype=np.int64)

        self._unit_until = last(form.unit_cells)
        self._source_until = last(form.in_sources)
        self._out_until = last(form.out_sources)
        self._target_until = last(form.out_targets)

    # --- events ---------------------------------------------------------------------------------

    def _take(self, event: Event) -> None:
        if isinstance(event, Received):
            key, payload = event
            try:
                if (unit := self._form.sense_units.get(key)) is not None:
                    self._take_sense(unit, payload)
                elif (part := self._form.in_parts.get(key)) is not None:
                    self._take_link(part, payload)
                elif key == self._control_key:
                    self._take_control(wire.decode_control(payload, len(self._until)))
            except WireError as error:
                self.counts.refuse(error)
        elif isinstance(event, Alive):
            # Somebody else's token is none of ours.
            if event.key == self._plant_key:
                self._plant_lost = self._plant_seen and not event.present
                self._plant_seen = self._plant_seen or event.present
        else:
            raise WokenError(f"shard {self._shard} was woken while it waited")

    def _take_sense(self, unit: int, payload: bytes) -> None:
        tick, presence, encoder_m = self._form.decode_sense(unit, payload)
        if self._timely("sense", tick, self._tick):
            slot = self._sense_slot(tick)
            if slot.have[unit]:
                raise WireError("sense", "duplicate", f"tick {tick} came already")
            rows = self._form.unit_rows[unit]
            slot.presence[rows] = presence
            if slot.encoder_m is not None:
                slot.encoder_m[rows] = encoder_m
            slot.have[unit] = True
            self.counts.delivered += 1

    def _take_link(self, part: int, payload: bytes) -> None:
        tick, sent, message = self._form.decode_link(part, payload)
        if self._timely("link", tick, self._tick - 1):
            slot = self._link_slot(tick)
            if slot.have[part]:
                raise WireError("link", "duplicate", f"tick {tick} came already")
            links = self._form.in_links[part]
            slot.sent[links] = sent
            slot.message[links] = message
            slot.have[part] = True
            self.counts.delivered += 1

    def _take_control(self, control: Control) -> None:
        if control.kind == "stop":
            self._stop = control
        elif control.kind == "lost":
            lattice = self._partition.lattice
            if not all(cell in lattice for cell in control.cells):
                raise WireError("control", "cells", "names a cell that is not in the array")
            # Not from the record's tick on but at once: what they sent before has arrived before this record.
            self.counts.lost += self._waited_for()
            self.retire((lattice.index(cell) for cell in control.cells), 0)
            self.counts.lost -= self._waited_for()
        self.counts.delivered += 1

    def _waited_for(self) -> int:
        slot = self._links.get(self._tick - 1)
        return (
            0 if slot is None else int(np.count_nonzero(~slot.have & (self._source_until > self._tick - 1)))
        )

    def _timely(self, kind: str, tick: int, now: int) -> bool:
        if tick < now:
            self.counts.late += 1
            return False
        if tick > now + EARLY_TICKS:
            raise WireError(kind, "ahead", f"tick {tick}: must be at most {EARLY_TICKS} ahead of {now}")
        return True

    def _sense_slot(self, tick: int) -> _Sense:
        slot = self._senses.get(tick)
        if slot is None:
            n = len(self._cells)
            encoder_m = np.zeros((n, 2)) if self._encoders else None
            presence = np.zeros((n, self._sensors), dtype=np.bool_)
            slot = self._senses[tick] = _Sense(presence, encoder_m, len(self._form.unit_rows))
        return slot

    def _link_slot(self, tick: int) -> _Links:
        slot = self._links.get(tick)
        if slot is None:
            assert self._message is not None
            slot = self._links[tick] = _Links(self._incoming, self._message, len(self._form.in_links))
        return slot
