"""The plant's side of the lockstep."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, final

import numpy as np

from bus import wire
from bus.counts import Counts, Loss, Reason
from bus.errors import BarrierError, BusError, WireError, WokenError
from bus.forms import FORMS, FormName
from bus.forms.form import HostForm, Wiring
from bus.keys import plant_key, shard_key
from bus.partition import Partition
from bus.specs import StallSpec
from bus.transport import Alive, Endpoint, Event, Received, Woken
from bus.wire import Control, DriveFrame, SenseFrame

NEVER: Final = np.iinfo(np.int64).max
"""The tick from which a live cell is gone."""
EARLY_TICKS: Final = 64
"""How far ahead a frame may be to be kept; nobody in lockstep gets further than one tick."""
_POLL_S: Final = 0.02
"""How often to ask for matches, of which no event tells."""
_STATE_POLL_S: Final = 0.5


@final
class _Slot:
    """What has come in for one tick."""

    __slots__ = ("drive", "have", "missing")

    def __init__(self, cells: int, have: wire.Mask, missing: int) -> None:
        self.drive = np.zeros((cells, 2))
        self.have = have
        self.missing = missing


@final
class Host:
    """Publishes what the cells sense, gathers what they drive, and waits for nobody who is gone.

    Blocking, one thread. It subscribes at once. The endpoint stays the caller's, to close later.

    Args:
        endpoint: The plant's endpoint.
        partition: How the cells are cut into shards; the same on all sides.
        form: ``"packed"`` or ``"cells"``; the same on all sides.
        run: Name of the run.
        sensors: Presence sensors a cell.
        encoders: Whether sense frames carry encoder travel.
        message: The firmware's message type, None where cells send each other nothing.
        stall: Deadlines. The policy is the caller's to carry out on the losses that ``gather`` names.
        clock: Monotonic wall seconds.

    Attributes:
        counts: Payloads of this side so far.
    """

    def __init__(
        self,
        endpoint: Endpoint,
        partition: Partition,
        form: FormName,
        *,
        run: str,
        sensors: int,
        encoders: bool,
        message: np.dtype[Any] | None,
        stall: StallSpec | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        wiring = Wiring(run, partition, sensors, encoders, message)
        self._endpoint = endpoint
        self._partition = partition
        self._encoders = encoders
        self._sensors = sensors
        self._stall = StallSpec() if stall is None else stall
        self._clock = clock
        self._form: HostForm = FORMS[form].host(wiring)
        self.counts = Counts()
        n, units = len(partition.lattice), len(self._form.unit_cells)
        self._until = np.full(n, NEVER, dtype=np.int64)
        self._unit_until = np.full(units, NEVER, dtype=np.int64)
        self._all_live = True
        self._slots: dict[int, _Slot] = {}
        self._tick = 0
        self._gone: set[int] = set()
        self._losses: list[Loss] = []
        self._failed: list[wire.Report] = []
        self._shard_counts: dict[int, Counts] = {}
        self._alive: set[int] = set()
        self._ready: set[int] = set()
        self._left: set[int] = set()
        self._reports = {shard_key(run, s, "report"): s for s in range(partition.count)}
        self._drive_units = self._form.drive_units
        self._control = endpoint.publisher(plant_key(run, "control"))
        self._state = endpoint.publisher(plant_key(run, "state"))
        self._state_asked = -_STATE_POLL_S
        self._state_wanted = False
        self._sense = [endpoint.publisher(key) for key in self._form.sense_keys]
        endpoint.subscribe(self._form.drive_expr)
        endpoint.subscribe(shard_key(run, None, "report"))
        endpoint.watch_alive(self._form.alive_expr)
        endpoint.watch_alive(self._form.ready_expr)
        self._alive_key = plant_key(run, "alive")
        endpoint.declare_alive(self._alive_key)

    # --- the start ------------------------------------------------------------------------------

    def barrier(self, deadline_s: float | None = None) -> None:
        """Waits until every cell is ready and can be heard, then tells all to start.

        Args:
            deadline_s: Wall seconds from now; None: ``stall.start_s``.

        Raises:
            BarrierError: Somebody is missing; names who, and whether they ever appeared.
            WokenError: ``endpoint.wake`` was called.
        """
        limit = self._stall.start_s if deadline_s is None else deadline_s
        deadline = self._clock() + limit
        waiting = set(range(len(self._sense)))
        while True:
            if len(self._ready) == len(self._sense):
                waiting = {unit for unit in waiting if not self._sense[unit].matched()}
                if not waiting:
                    break
            left = deadline - self._clock()
            if left <= 0:
                raise self._missing(limit, waiting)
            # Tokens come as events, matches must be asked for: they follow the tokens at once.
            everybody = len(self._ready) == len(self._sense)
            event = self._endpoint.receive(min(left, _POLL_S) if everybody else left)
            if event is not None:
                self._take(event)
        self.control(Control("start", 0))

    def _missing(self, limit: float, unheard: set[int]) -> BarrierError:
        units = range(len(self._sense))
        never = [u for u in units if u not in self._alive and u not in self._left]
        left = [u for u in units if u not in self._alive and u in self._left]
        unready = [u for u in units if u in self._alive and u not in self._ready]
        parts = [
            f"{verb}: {self._names(who)}"
            for verb, who in (
                ("never appeared", never),
                ("appeared and left again", left),
                ("appeared but not ready", unready),
                ("ready but does not hear the plant", [] if never or left or unready else sorted(unheard)),
            )
            if who
        ]
        return BarrierError(
            f"not everybody is ready after {limit:g} s; {'; '.join(parts)}",
            absent=self._cells(never + left),
            unready=self._cells(unready),
        )

    def _cells(self, units: Sequence[int]) -> list[tuple[int, int]]:
        cells = self._partition.lattice.cells
        return [cells[i] for unit in units for i in self._form.unit_cells[unit]]

    def _names(self, units: Sequence[int], most: int = 12) -> str:
        cells = self._cells(units)
        text = " ".join(f"{row},{column}" for row, column in cells[:most])
        more = f" and {len(cells) - most} more" if len(cells) > most else ""
        return f"{len(cells)} cell{'s' if len(cells) != 1 else ''} ({text}{more})"

    # --- a tick ---------------------------------------------------------------------------------

    def publish(self, frame: SenseFrame) -> None:
        """Sends every live cell its senses: ``presence`` ``(n, sensors)``, ``encoder_m`` ``(n, 2)`` or None.

        Raises:
            BusError: The frame's shape is not what was agreed.
        """
        n = len(self._until)
        if frame.presence.shape != (n, self._sensors) or (frame.encoder_m is None) == self._encoders:
            raise BusError(
                f"sense frame of tick {frame.tick}: must have presence {(n, self._sensors)} "
                f"{'and' if self._encoders else 'without'} encoder travel, has {frame.presence.shape}"
            )
        payloads = self._form.sense_payloads(frame)
        if self._all_live:
            for publisher, payload in zip(self._sense, payloads, strict=True):
                publisher.put(payload)
            self.counts.sent += len(payloads)
            return
        for unit in np.nonzero(self._unit_until > frame.tick)[0].tolist():
            self._sense[unit].put(payloads[unit])
            self.counts.sent += 1

    def gather(self, tick: int) -> tuple[DriveFrame, list[Loss]]:
        """Waits until every live cell's drive for ``tick`` is there, or its cell is given up.

        Args:
            tick: Must go up from call to call.

        Returns:
            The drives ``(n, 2)``, zero for cells that are gone, and the cells lost at this tick, ascending.
            Neighbours have been told to stop waiting for these.

        Raises:
            WokenError: ``endpoint.wake`` was called; the call may be repeated.
        """
        self._tick = tick
        slot = self._slot(tick)
        deadline = self._clock() + self._stall.deadline_s
        receive, clock = self._endpoint.receive, self._clock
        while True:
            if self._gone or self._failed:
                self._bury(slot)
            if slot.missing <= 0:
                break
            event = receive(max(deadline - clock(), 0.0))
            if event is not None:
                self._take(event)
            elif clock() >= deadline:
                self._give_up(slot)
        self._tick = tick + 1
        for over in [t for t in self._slots if t <= tick]:
            del self._slots[over]
        if not self._all_live:
            slot.drive[self._until <= tick] = 0.0
        losses, self._losses = self._losses, []
        return DriveFrame(tick, slot.drive), sorted(losses, key=lambda loss: loss.cell)

    def retire(self, cells: Iterable[int], tick: int) -> None:
        """Stops waiting for ``cells`` (indices) from ``tick`` on: a scheduled death, which is no loss."""
        index = np.fromiter(cells, dtype=np.int64)
        self._until[index] = np.minimum(self._until[index], tick)
        self._recount()

    def live(self, tick: int) -> wire.Mask:
        """``(n,)``: the cells that take part in ``tick``."""
        return self._until > tick

    # --- to all ---------------------------------------------------------------------------------

    def control(self, record: Control) -> None:
        """Sends a control record to everybody."""
        self._control.put(wire.encode_control(record))
        self.counts.sent += 1

    def publish_state(self, payload: bytes) -> None:
        """Puts ``payload`` on the plant's state key while somebody listens; asked about twice a second."""
        now = self._clock()
        if now - self._state_asked >= _STATE_POLL_S:
            self._state_asked = now
            self._state_wanted = self._state.matched()
        if self._state_wanted:
            self._state.put(payload)

    def stop(self, detail: str = "", deadline_s: float = 2.0) -> Counts:
        """Tells the cells to stop and waits until their tokens are gone.

        Args:
            detail: Why, for the cells' logs.
            deadline_s: Wall seconds to wait.

        Returns:
            The counts of all sides: this one's, and those that the shards reported as they left.
        """
        self.control(Control("stop", self._tick, (), detail))
        deadline = self._clock() + deadline_s
        while self._alive and (left := deadline - self._clock()) > 0:
            event = self._endpoint.receive(left)
            if event is not None and not isinstance(event, Woken):
                self._take(event)
        return sum(self._shard_counts.values(), self.counts)

    def close(self) -> None:
        """Takes the plant's token back; members take that for its end."""
        self._endpoint.withdraw(self._alive_key)

    # --- events ---------------------------------------------------------------------------------

    def _take(self, event: Event) -> None:
        if isinstance(event, Received):
            unit = self._drive_units.get(event.key)
            try:
                if unit is not None:
                    self._drive(unit, event.payload)
                elif event.key in self._reports:
                    self._report(self._reports[event.key], event.payload)
                else:
                    raise WireError("bus", "key", f"{event.key} belongs to no cell of this run")
            except WireError as error:
                self.counts.refuse(error)
        elif isinstance(event, Alive):
            self._token(event)
        else:
            raise WokenError("the plant was woken while it waited for the cells")

    def _drive(self, unit: int, payload: bytes) -> None:
        tick, values = self._form.decode_drive(unit, payload)
        if tick < self._tick or self._unit_until[unit] <= tick:
            self.counts.late += 1
            return
        if tick > self._tick + EARLY_TICKS:
            raise WireError(
                "drive", "ahead", f"tick {tick}: must be at most {EARLY_TICKS} ahead of {self._tick}"
            )
        slot = self._slots.get(tick) or self._slot(tick)
        if slot.have[unit]:
            raise WireError("drive", "duplicate", f"tick {tick} came already")
        slot.drive[self._form.unit_rows[unit]] = values
        slot.have[unit] = True
        slot.missing -= 1
        self.counts.delivered += 1

    def _report(self, shard: int, payload: bytes) -> None:
        report = wire.decode_report(payload, len(self._until))
        if report.kind == "counts":
            self._shard_counts[shard] = Counts(*report.counts)
            return
        lattice, shard_of = self._partition.lattice, self._partition.shard_of
        if not all(cell in lattice and shard_of[lattice.index(cell)] == shard for cell in report.cells):
            raise WireError("report", "cells", f"must be cells of shard {shard}")
        self._failed.append(report)

    def _token(self, event: Alive) -> None:
        unit = self._form.alive_units.get(event.key)
        if unit is not None:
            if event.present:
                self._alive.add(unit)
                self._gone.discard(unit)
            else:
                self._alive.discard(unit)
                self._left.add(unit)
                self._gone.add(unit)
            return
        unit = self._form.ready_units.get(event.key)
        if unit is not None:
            (self._ready.add if event.present else self._ready.discard)(unit)

    # --- who is still there ---------------------------------------------------------------------

    def _slot(self, tick: int) -> _Slot:
        slot = self._slots.get(tick)
        if slot is None:
            units = len(self._sense)
            live = units if self._all_live else int(np.count_nonzero(self._unit_until > tick))
            slot = self._slots[tick] = _Slot(len(self._until), np.zeros(units, dtype=np.bool_), live)
        return slot

    def _recount(self) -> None:
        """After a death: who is still waited for, in every open tick."""
        self._all_live = False
        self._unit_until = np.array([self._until[cells].max() for cells in self._form.unit_cells])
        for tick, slot in self._slots.items():
            slot.missing = int(np.count_nonzero((self._unit_until > tick) & ~slot.have))

    def _bury(self, slot: _Slot) -> None:
        """Gives up the cells whose token went or whose process said that they failed."""
        tick = self._tick
        for report in [r for r in self._failed if r.tick <= tick]:
            self._failed.remove(report)
            failed = [self._partition.lattice.index(cell) for cell in report.cells]
            self._lose([i for i in failed if self._until[i] > tick], "failed", report.detail)
        # A unit whose drive came before its token went is lost at the next tick.
        gone = [unit for unit in self._gone if not slot.have[unit]]
        self._gone.difference_update(gone)
        self._lose_units([unit for unit in gone if self._unit_until[unit] > tick], "token lost")

    def _give_up(self, slot: _Slot) -> None:
        """Gives up everybody whose drive is not there at the deadline."""
        late = np.nonzero((self._unit_until > self._tick) & ~slot.have)[0].tolist()
        self._lose_units(late, "stalled")

    def _lose_units(self, units: list[int], reason: Reason) -> None:
        self.counts.lost += len(units)
        cells = [int(i) for unit in units for i in self._form.unit_cells[unit] if self._until[i] > self._tick]
        self._lose(cells, reason)

    def _lose(self, cells: list[int], reason: Reason, detail: str = "") -> None:
        if not cells:
            return
        self._until[cells] = self._tick
        self._recount()
        names = tuple(self._partition.lattice.cells[i] for i in sorted(cells))
        self.control(Control("lost", self._tick, names, detail or reason))
        self._losses += [Loss(i, self._tick, reason, detail) for i in cells]
