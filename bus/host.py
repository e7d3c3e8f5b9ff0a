"""The plant's side of the lockstep."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, Final, final

import numpy as np

from bus import wire
from bus.collector import EARLY_TICKS, Collector
from bus.counts import Counts, Loss, Reason
from bus.dispatch import Dispatcher
from bus.errors import BusError, WireError, WokenError
from bus.forms import FORMS, FormName
from bus.forms.form import HostForm, Wiring
from bus.keeping import Keeping, Together, decode_kept
from bus.keys import plant_key, shard_key
from bus.lives import Lives
from bus.partition import Partition
from bus.readings import Readings
from bus.registers import RegisterFrame, Shown, Wanted, decode_registers, due, joined
from bus.returns import Returns
from bus.roll import Roll
from bus.specs import StallSpec
from bus.transport import Endpoint
from bus.wire import Control, DriveFrame, Report, SenseFrame

_POLL_S: Final = 0.01
"""How often to ask for matches, of which no event tells."""
_STATE_POLL_S: Final = 0.5
_BEFORE: Final = -1
"""In place of a shard: all sides of a run before it was resumed."""


@final
class Host:
    """Publishes what the cells sense, gathers what they drive, and waits for nobody who is gone.

    Blocking, one thread. It subscribes at once. The endpoint stays the caller's, to close later.

    Args:
        endpoint: The plant's endpoint.
        partition: How the cells are cut into shards; the same on all sides.
        form: ``"packed"`` or ``"cells"``; the same on all sides.
        run: Name of the run.
        readings: What sense frames carry.
        message: The firmware's message type, None where cells send each other nothing.
        wanted: Registers of the cells to take in.
        keeps: Whether shards may be asked what they remember.
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
        readings: Readings,
        message: np.dtype[Any] | None,
        wanted: Sequence[Wanted] = (),
        keeps: bool = False,
        stall: StallSpec | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._endpoint = endpoint
        self._lattice = partition.lattice
        self._shard_of = partition.shard_of
        self._readings = readings
        self._stall = StallSpec() if stall is None else stall
        self._clock = clock
        self._form: HostForm = FORMS[form].host(Wiring(run, partition, readings, message))
        self.counts = Counts()
        self._tick = 0
        self._lives = Lives(len(partition.lattice))
        self._losses: list[Loss] = []
        # By cell, and the first of a cell stands: whoever sends them without end fills no memory.
        self._failed: dict[tuple[int, int], Report] = {}
        self._hung: dict[tuple[int, int], Report] = {}
        self._shard_counts: dict[int, Counts] = {}
        self._roll = Roll(self._form, partition.lattice)
        shards = [partition.shard_of[cells[0]] for cells in self._form.unit_cells]
        units = [[u for u, own in enumerate(shards) if own == s] for s in range(partition.count)]
        self._returns = Returns(self._roll, units, lambda unit: self._sense[unit].matched())
        self._drives = Collector("drive", self._form.blank_drives, self._form.decode_drive, self.counts)
        self._inbox = Dispatcher(endpoint, self.counts, self._roll.take)
        for key, unit in self._form.drive_units.items():
            self._inbox.routes[key] = (self._drives.take, unit)
        for shard in range(partition.count):
            self._inbox.routes[shard_key(run, shard, "report")] = (self._report, shard)
        self._shown: dict[tuple[int, int], RegisterFrame] = {}
        """By tick and shard."""
        self._wanted = tuple(wanted)
        if self._wanted:
            for shard in range(partition.count):
                self._inbox.routes[shard_key(run, shard, "registers")] = (self._take_registers, shard)
            endpoint.subscribe(shard_key(run, None, "registers"), "quiet")
        self._keeping: Keeping | None = None
        if keeps:
            for shard in range(partition.count):
                self._inbox.routes[shard_key(run, shard, "memory")] = (self._take_kept, shard)
            endpoint.subscribe(shard_key(run, None, "memory"), "quiet")
        self._control = endpoint.publisher(plant_key(run, "control"))
        self._state = endpoint.publisher(plant_key(run, "state"))
        self._state_asked: float | None = None
        self._state_wanted = False
        self._sense = [endpoint.publisher(key) for key in self._form.sense_keys]
        endpoint.subscribe(self._form.drive_expr)
        endpoint.subscribe(shard_key(run, None, "report"), "urgent")
        endpoint.watch_alive(self._form.alive_expr)
        endpoint.watch_alive(self._form.ready_expr)
        self._alive_key = plant_key(run, "alive")
        endpoint.declare_alive(self._alive_key)

    # --- the start ------------------------------------------------------------------------------

    def barrier(self, deadline_s: float | None = None) -> None:
        """Waits until every cell is ready and can be sent to, then tells all to start.

        Args:
            deadline_s: Wall seconds from now; None: ``stall.start_s``.

        Raises:
            BarrierError: Somebody is missing; names who, and whether they ever appeared.
            WokenError: ``endpoint.wake`` was called.
        """
        limit = self._stall.start_s if deadline_s is None else deadline_s
        deadline = self._clock() + limit
        waiting = list(range(len(self._sense)))
        while True:
            everybody = self._roll.complete()
            if everybody:
                waiting = [unit for unit in waiting if not self._sense[unit].matched()]
                if not waiting:
                    break
            left = deadline - self._clock()
            if left <= 0:
                raise self._roll.missing(limit, waiting)
            # Tokens come as events, matches must be asked for: they come with the tokens.
            self._inbox.read(min(left, _POLL_S) if everybody else left)
        start = Control("start", self._tick)
        if _BEFORE in self._shard_counts:  # counted when the run began
            self._control.put(wire.encode_control(start))
        else:
            self.control(start)

    # --- a tick ---------------------------------------------------------------------------------

    def publish(self, frame: SenseFrame) -> None:
        """Sends every live cell its senses.

        Raises:
            BusError: The frame is not what was agreed.
        """
        agreed, found = _agreed(self._readings, len(self._lattice)), _found(frame)
        if frame.picture is not None and not self._readings.camera:
            found["a picture"] = frame.picture.pose.shape
        if found != agreed:
            raise BusError(f"sense frame of tick {frame.tick}: must have {agreed}, has {found}")
        puts = list(zip(self._sense, self._form.sense_payloads(frame), strict=True))
        if not self._lives.all:
            puts = [put for put, until in zip(puts, self._drives.until, strict=True) if until > frame.tick]
        self._endpoint.put_all(puts)
        self.counts.sent += len(puts)

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
        slot = self._drives.slot(tick)
        deadline = self._clock() + self._stall.deadline_s
        read, clock = self._inbox.read, self._clock
        while True:
            if self._roll.gone or self._failed:
                self._bury(slot.have)
            if slot.missing <= 0:
                break
            if not read(max(deadline - clock(), 0.0), slot.missing) and clock() >= deadline:
                self._lose_units(self._drives.missing(tick), "stalled")
        drive = self._form.join_drives(self._drives.close(tick).values)
        if not self._lives.all:
            drive[~self._lives.live(tick)] = 0.0
        losses, self._losses = self._losses, []
        return DriveFrame(tick, drive), sorted(losses, key=lambda loss: loss.cell)

    def retire(self, cells: Iterable[int], tick: int) -> None:
        """Stops waiting for ``cells`` (indices) from ``tick`` on: a scheduled death, which is no loss."""
        self._lives.retire(cells, tick)
        self._drives.bury(self._lives.last(self._form.unit_cells))

    def resume(self, tick: int, dead: Sequence[int], counts: Counts) -> None:
        """Goes on at ``tick`` where another side of the same run was; before the barrier.

        Args:
            tick: The first to be published and gathered.
            dead: Indices of the cells that had gone before it.
            counts: Of all sides by then.
        """
        self._tick = tick
        self._drives.begin(tick)
        if dead:
            self.retire(dead, 0)
        self._shard_counts[_BEFORE] = counts

    def ask(self, tick: int) -> None:
        """Asks the shards what they remember before ``tick``; before ``publish`` of the one before."""
        self._control.put(wire.encode_control(Control("keep", tick)))
        live = self._lives.live(tick - 1)
        self._keeping = Keeping(tick, np.unique(self._shard_of[live]).tolist())

    def note(self) -> None:
        """Notes, with ``tick`` about to begin for which was asked, what this side has counted."""
        assert self._keeping is not None
        self._keeping.note(self.counts)

    def take_kept(self) -> Together | None:
        """What all sides remember, once everybody asked has answered."""
        together = None if self._keeping is None else self._keeping.together(self._shard_counts)
        if together is not None:
            self._keeping = None
        return together

    def give_up(self) -> list[int]:
        """Waits no longer for what shards remember; returns those that have not answered."""
        keeping, self._keeping = self._keeping, None
        return [] if keeping is None else keeping.missing

    def live(self, tick: int) -> wire.Mask:
        """``(n,)``: the cells that take part in ``tick``."""
        return self._lives.live(tick)

    def admit(self, tick: int) -> list[int]:
        """Lets cells take part again whose process went and whose new one is ready; for between two ticks.

        Args:
            tick: The next.

        Returns:
            Their indices, ascending: they are waited for from ``tick`` on. All others have been told.
        """
        if not self._returns:
            return []
        names = self._lattice.cells
        for absence in self._returns.to_ask():
            self.control(Control("joining", tick, tuple(names[i] for i in absence.cells)))
        others = np.unique(self._shard_of[self._lives.live(tick)]).tolist()
        cells = self._returns.back(others)
        if cells:
            self._lives.admit(cells, tick)
            units = self._form.unit_cells
            self._drives.admit(self._lives.first(units), self._lives.last(units))
            # whoever is new knows nobody who went before
            gone = tuple(names[i] for i in np.flatnonzero(~self._lives.live(tick)).tolist())
            self.control(Control("lost", 0, gone))
            self.control(Control("joined", tick, tuple(names[i] for i in cells)))
        return cells

    def take_hung(self) -> list[Report]:
        """Programs that have hung since the last call, and why; their cells still take part."""
        hung, self._hung = self._hung, {}
        return list(dict.fromkeys(hung.values()))

    def take_registers(self) -> list[Shown]:
        """What cells have shown of themselves since the last call; a tick's is there when its drives are."""
        frames, self._shown = self._shown, {}
        return joined(list(frames.values()), self._lattice)

    # --- to all ---------------------------------------------------------------------------------

    def control(self, record: Control) -> None:
        """Sends a control record to everybody."""
        self._control.put(wire.encode_control(record))
        self.counts.sent += len(np.unique(self._shard_of[self._lives.live(self._tick)]))

    def publish_state(self, payload: bytes) -> None:
        """Puts ``payload`` on the plant's state key while somebody listens; asked about twice a second."""
        now = self._clock()
        if self._state_asked is None or now - self._state_asked >= _STATE_POLL_S:
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
        while self._roll.alive and (left := deadline - self._clock()) > 0:
            # Whoever wakes us wants what is happening already.
            with contextlib.suppress(WokenError):
                self._inbox.read(left)
        return sum(self._shard_counts.values(), self.counts)

    def close(self) -> None:
        """Takes the plant's token back; members take that for its end."""
        self._endpoint.withdraw(self._alive_key)

    # --- events ---------------------------------------------------------------------------------

    def _report(self, shard: int, payload: bytes) -> None:
        report = wire.decode_report(payload, len(self._lattice))
        if report.kind == "counts":
            self._shard_counts[shard] = Counts.reported(report.counts, report.tally)
            return
        if report.kind == "linked":
            cells = [self._lattice.index(cell) for cell in report.cells if cell in self._lattice]
            self._returns.linked(shard, cells)
            return
        own = (c in self._lattice and self._shard_of[self._lattice.index(c)] == shard for c in report.cells)
        if not report.cells or not all(own):
            raise WireError("report", "cells", f"must be cells of shard {shard}")
        if report.tick > self._tick + EARLY_TICKS:
            raise WireError("report", "ahead", f"tick {report.tick}: must be at most {EARLY_TICKS} ahead")
        kept = self._failed if report.kind == "failed" else self._hung
        for cell in report.cells:
            kept.setdefault(cell, report)

    def _take_registers(self, shard: int, payload: bytes) -> None:
        cells = int(np.count_nonzero(self._shard_of == shard))
        frame = decode_registers(payload, cells)
        rows = self._lattice.find(*frame.cells.T.astype(np.int64))
        if (rows < 0).any() or (self._shard_of[rows] != shard).any():
            raise WireError("registers", "cells", f"must be cells of shard {shard}")
        # They come between the senses of their tick and its drives.
        if frame.tick > self._tick:
            raise WireError("registers", "ahead", f"tick {frame.tick}: must be at most {self._tick}")
        if frame.tick < self._tick:
            self.counts.late += 1
            return
        if (frame.tick, shard) in self._shown:
            raise WireError("registers", "duplicate", f"tick {frame.tick} came already")
        self.counts.delivered += 1
        if due(self._wanted, frame.tick) is not None:
            self._shown[frame.tick, shard] = frame  # others are for those who watch

    def _take_kept(self, shard: int, payload: bytes) -> None:
        kept = decode_kept(payload, int(np.count_nonzero(self._shard_of == shard)))
        if self._keeping is not None:  # else it comes too late
            self._keeping.take(shard, kept)

    # --- who is still there ---------------------------------------------------------------------

    def _bury(self, have: bytearray) -> None:
        """Gives up the cells whose token went or whose process said that they failed."""
        tick = self._tick
        told = {cell: report for cell, report in self._failed.items() if report.tick <= tick}
        for report in dict.fromkeys(told.values()):
            cells = [cell for cell, one in told.items() if one is report]
            self._lose(map(self._lattice.index, cells), "failed", report.detail)
            for cell in cells:
                del self._failed[cell]
        # A unit whose drive came before its token went is lost at the next tick.
        gone = [unit for unit in self._roll.gone if not have[unit]]
        self._roll.gone.difference_update(gone)
        self._lose_units([unit for unit in gone if self._drives.until[unit] > tick], "token lost")

    def _lose_units(self, units: list[int], reason: Reason) -> None:
        self.counts.lost += len(units)
        before = len(self._losses)
        self._lose([int(i) for unit in units for i in self._form.unit_cells[unit]], reason)
        for loss in self._losses[before:]:
            self._returns.left(int(self._shard_of[loss.cell]), (loss.cell,))

    def _lose(self, cells: Iterable[int], reason: Reason, detail: str = "") -> None:
        lost = sorted(i for i in cells if self._lives.until[i] > self._tick)
        if lost:
            self.retire(lost, self._tick)
            names = tuple(self._lattice.cells[i] for i in lost)
            self.control(Control("lost", self._tick, names, detail or reason))
            self._losses += [Loss(i, self._tick, reason, detail) for i in lost]


def _agreed(readings: Readings, cells: int) -> dict[str, tuple[int, ...]]:
    """Shapes of what a sense frame has to have, by name."""
    each = (cells, readings.sensors)
    shapes = {
        "presence": each,
        "encoder travel": (cells, 2) if readings.encoders else None,
        "levels": each if readings.levels else None,
        "labels": (cells,) if readings.labels else None,
    }
    return {name: shape for name, shape in shapes.items() if shape is not None}


def _found(frame: SenseFrame) -> dict[str, tuple[int, ...]]:
    """Shapes of what it has."""
    arrays = {
        "presence": frame.presence,
        "encoder travel": frame.encoder_m,
        "levels": frame.level,
        "labels": frame.label,
    }
    return {name: array.shape for name, array in arrays.items() if array is not None}
