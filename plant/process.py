"""The plant on the bus: one exchange with the cells and one advance of the plant a tick."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Literal, NamedTuple, Protocol, final

import numpy as np
from numpy.typing import NDArray

from bus.lockstep.counters import Loss
from bus.state import StateFields
from bus.wire.frames import DriveFrame, SenseFrame
from plant.dead_cells import DeadCells
from plant.observations import Sense
from plant.sampling import Timing

if TYPE_CHECKING:
    from bus.fault import FaultInstance
    from bus.spec import StallSpec
    from plant.effects.camera.camera import Camera
    from plant.faults.base import PlantFault
    from plant.faults.schedule import FaultSchedule
    from plant.observations import Event
    from plant.plant import Plant
    from plant.wheels import LossPolicy


Floats = NDArray[np.float64]
Status = Literal["ok", "failed", "stalled"]


class TickRecord(NamedTuple):
    """All that happened in one tick.

    Attributes:
        tick: Which, from 0.
        start_ns: When it began.
        until_ns: When it ended.
        sense: What the cells sensed at its start.
        wheel_speed: ``(n, 2)`` m/s at its start.
        before: ``(m, 6)`` parcel states at its start.
        drives: ``(n, 2)`` that acted during it, a dead cell's as the stall policy has it.
        after: ``(m, 6)`` parcel states at its end.
        events: Of the plant, during it.
        died: Indices of the cells whose scheduled death for good was at its start.
        losses: Cells that were found lost in it.
    """

    tick: int
    start_ns: int
    until_ns: int
    sense: Sense
    wheel_speed: Floats
    before: Floats
    drives: Floats
    after: Floats
    events: Sequence[Event]
    died: tuple[int, ...]
    losses: Sequence[Loss]


@final
@dataclass(frozen=True, slots=True)
class LoopResult:
    """How the loop ended.

    Attributes:
        status: ``ok`` at the end of the duration; ``failed`` or ``stalled`` where the policy is ``abort``; ``failed``
            where a program failed and that ends the run, and where no cell is left at the end.
        losses: Cells found lost in the tick in which it ended.
        died: Cells whose scheduled death it was aborted for, for good or until they are repaired.
        failed: Of the losses, the cells whose program failed, where that ended it.
        nobody: Whether no cell was left at the end of the duration, though the scene did not order it.
    """

    status: Status
    losses: tuple[Loss, ...] = ()
    died: tuple[int, ...] = ()
    failed: tuple[Loss, ...] = ()
    nobody: bool = False


class LockstepPort(Protocol):
    """What the process needs of ``bus.lockstep.Coordinator``."""

    def publish(self, frame: SenseFrame) -> None:
        """Tell every cell what it senses."""
        ...

    def gather(self, tick: int) -> tuple[DriveFrame, Sequence[Loss]]:
        """Wait for every cell's drive, or its loss."""
        ...

    def mark_dead(self, cells: Sequence[int], tick: int) -> None:
        """Stop waiting for these cells from ``tick`` on."""
        ...


@final
class PlantProcess:
    """Runs the plant and the bus in lockstep, in one blocking thread.

    In tick k the cells are told what they sense at ``t_k = k tick_ns`` and answer with the drives that act on
    the whole of ``[t_k, t_(k+1))``; the last interval ends with the run and may be shorter. A cell that dies,
    scheduled or not, is not waited for again; its wheels do what the stall policy says, from that tick on. With
    clocks of their own, cells are told at t_k what each last read, and each drive acts from an instant within
    ``[t_k, t_(k+1))`` on.

    Args:
        plant: At time 0.
        host: Past its barrier.
        tick_ns: Of a tick: the cells' control period, or the window that an exchange serves.
        duration_ns: Of the run.
        schedule: Indices of the cells that die for good at the start of a tick, by tick.
        stall: What happens when a cell goes unscheduled; the scheduled dead follow the same policy.
        stops: Whether a program that fails ends the run, whatever ``stall`` says.
        observer: Told of every tick when it is over, before anything of the next is awaited; what it raises
            ends the run between two ticks.
        pace: Called with a tick's start, ns, before the tick begins; may wait.
        timing: Where cells have instants of their own: asked in order of ticks when, in a tick, the drives that it
            brought act and when cells read what they are told in the next. An instant may lie beyond the run's end.
        camera: Whose pictures the cells are shown; None: none's.
        faults: That begin and end on the way; None: none does.
        attend: Called with the next tick before it begins: the time to inject faults.
        rests: What the wheels of cells do that die for good as scheduled, by cell, where ``stall`` doesn't say it.

    Attributes:
        tick: The tick that is under way, or the next.
        time_ns: Simulated time reached.
        waiting: Whether the process waits for the cells or the clock: an exception raised by a signal handler
            at such a time leaves the plant at ``time_ns``, with every tick before it reported.
    """

    remembers: ClassVar[StateFields] = StateFields(
        "_plant",
        "_sense",
        "_state",
        "_drives",
        "_faults",
        "_undriven",
        "_camera",
        "_timing",
        "tick",
        "time_ns",
        records=(Sense,),
    )

    def __init__(
        self,
        plant: Plant,
        host: LockstepPort,
        *,
        tick_ns: int,
        duration_ns: int,
        schedule: Mapping[int, tuple[int, ...]],
        stall: StallSpec,
        stops: bool = False,
        observer: Callable[[TickRecord], None],
        pace: Callable[[int], None] | None = None,
        timing: Callable[[int], Timing] | None = None,
        camera: Camera | None = None,
        faults: FaultSchedule | None = None,
        attend: Callable[[int], None] | None = None,
        rests: Mapping[int, LossPolicy] | None = None,
    ) -> None:
        self._plant = plant
        self._host = host
        self._tick_ns = tick_ns
        self._timing = timing
        self._camera = camera
        self._duration_ns = duration_ns
        self._schedule = schedule
        self._abort = stall.policy == "abort"
        self._stops = stops
        self._observer = observer
        self._pace = pace
        self._sense = plant.sense()
        self._state = plant.state
        n = len(self._sense.presence)
        self._drives: Floats = np.zeros((n, 2))
        self._faults = faults
        self._attend = attend
        self._undriven = DeadCells(plant, n, "coast" if stall.policy == "abort" else stall.policy, rests)
        self._over: TickRecord | None = None
        self.tick = 0
        self.time_ns = 0
        self.waiting = False

    def run(self) -> LoopResult:
        """Run to the end of the duration, or to the first loss that ends the run.

        Raises:
            PlantError: The plant could not advance.
            BusError: The bus broke.
        """
        abort = self._abort
        while self.time_ns < self._duration_ns:
            if self._attend is not None:
                self._attend(self.tick)
            if abort and (dying := self._dying()):
                self.report()
                return LoopResult("failed", died=dying)
            losses = self.step()
            if losses and (ended := self._ended(losses)):
                return ended
        self.report()
        return LoopResult("failed", nobody=True) if self._nobody() else LoopResult("ok")

    def _ended(self, losses: Sequence[Loss]) -> LoopResult | None:
        """How the run ends with these losses; None: it goes on."""
        failed = tuple(loss for loss in losses if loss.reason == "failed")
        if failed and self._stops:
            return LoopResult("failed", tuple(losses), failed=failed)
        if self._abort:
            stalled = all(loss.reason == "stalled" for loss in losses)
            return LoopResult("stalled" if stalled else "failed", tuple(losses))
        return None

    def _nobody(self) -> bool:
        """Whether no program drives any wheel any more, and for one cell at least not because the scene says so."""
        gone = self._undriven.mask
        if gone is None or not gone.all():
            return False
        ordered = np.zeros(len(gone), dtype=np.bool_)
        for tick, cells in self._schedule.items():
            if tick < self.tick:
                ordered[list(cells)] = True
        if self._faults is not None:
            harm = self._faults.state_at(self.tick - 1, live=False)
            ordered |= harm.dead | harm.gone
        return not ordered.all()

    def revive(self, cells: Sequence[int]) -> None:
        """Cells that were lost take part again from the next tick on."""
        self._undriven.revive(cells)

    def inject(self, fault: FaultInstance[PlantFault]) -> None:
        """One more fault, from the next tick on at the earliest."""
        if self._faults is None:
            from plant.faults.schedule import FaultSchedule

            self._faults = FaultSchedule(len(self.lost))
        self._faults.add(fault)
        self.replan()

    def replan(self) -> None:
        """Heed that the end of a fault has changed."""
        if self._faults is not None:
            self._faults.plan(self.tick)

    def step(self) -> Sequence[Loss]:
        """One tick. Returns the cells that were found lost in it; where that ends the run the plant then stays."""
        tick, start_ns, sense, plant = self.tick, self.time_ns, self._sense, self._plant
        if self._faults is not None and tick >= self._faults.next_transition:
            self._turn(self._faults, tick)
            sense = self._sense
        died = self._schedule.get(tick, ()) if self._schedule else ()
        if died:
            died = self._undriven.mark_dead(died, self._drives)
        drives, losses = self._exchange(tick, start_ns, sense, died)
        if losses:
            if self._ended(losses):
                return losses
            self._undriven.mark_dead([loss.cell for loss in losses], self._drives)
        drives = self._undriven.override_drives(drives)
        until_ns = min(start_ns + self._tick_ns, self._duration_ns)
        before, wheel_speed = self._state, plant.wheel_speed
        self._sense, events = self._advance(tick, drives, until_ns)
        self.tick, self.time_ns, self._state = tick + 1, until_ns, plant.state
        self._over = TickRecord(
            tick,
            start_ns,
            until_ns,
            sense,
            wheel_speed,
            before,
            self._drives,
            self._state,
            events,
            died,
            losses,
        )
        return losses

    def _advance(self, tick: int, drives: Floats, until_ns: int) -> tuple[Sense, list[Event]]:
        """Let the plant move on through a tick."""
        if self._timing is None:
            self._drives = drives
            return self._plant.advance(drives, until_ns)
        acts_ns, reads_ns = self._timing(tick)
        if self._undriven.mask is not None:
            acts_ns = np.where(self._undriven.mask, -1, acts_ns)
        # The last tick may be over before a drive would have acted: its wheels go on as they were.
        late = acts_ns >= until_ns
        self._drives = np.where(late[:, None], self._drives, drives)
        timing = Timing(np.where(late, -1, acts_ns), np.where(reads_ns < until_ns, reads_ns, -1))
        return self._plant.advance(self._drives, until_ns, timing)

    def _exchange(
        self, tick: int, start_ns: int, sense: Sense, died: tuple[int, ...]
    ) -> tuple[Floats, Sequence[Loss]]:
        """Tell the cells what they sense, and hear what they do.

        Those who die in this tick still sense: that a tick begins tells them that all they sent has arrived.
        The tick before is reported while the cells compute.
        """
        if self._pace is not None:
            self.report()
            self.waiting = True
            try:
                self._pace(start_ns)
            finally:
                self.waiting = False
        picture = None
        if self._camera is not None:
            picture = self._camera.look(tick, self._state, self._plant.on_surface)
        self._host.publish(
            SenseFrame(tick, sense.presence, sense.encoder_m, sense.level, sense.label, picture)
        )
        if died:
            self._host.mark_dead(died, tick)
        self.report()
        self.waiting = True
        try:
            frame, losses = self._host.gather(tick)
        finally:
            self.waiting = False
        return frame.drive, losses

    def report(self) -> None:
        """Hand the last tick to the observer, once."""
        record, self._over = self._over, None
        if record is not None:
            self._observer(record)

    def _dying(self) -> tuple[int, ...]:
        """Cells that die as the next tick begins."""
        dying = set(self._schedule.get(self.tick, ()))
        if self._faults is not None and self.tick >= self._faults.next_transition:
            dying.update(self._undriven.about_to_die(self._faults.state_at(self.tick)))
        return tuple(sorted(dying))

    def _turn(self, faults: FaultSchedule, tick: int) -> None:
        """Faults begin or end: put the plant in the state that they leave it in."""
        if self._undriven.on_transition(faults.at_transition(tick), self._drives):
            self._sense = self._plant.last_readings

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Whether each cell is dead for good, ``(n,)``."""
        return self._undriven.lost

    @property
    def sense(self) -> Sense:
        """What the cells would sense now."""
        return self._sense
