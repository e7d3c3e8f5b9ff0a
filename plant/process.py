"""The plant on the bus: one exchange with the cells and one advance of the plant a tick."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.lockstep.counters import Loss
from bus.state import StateFields
from bus.wire.frames import SenseFrame
from plant.dead_cells import DeadCells
from plant.delayed_drives import DelayedDrives
from plant.observations import Sense
from plant.sampling import Timing
from plant.tick import DeathPolicy, Floats, LockstepPort, LoopResult, RunClock, TickHooks, TickRecord

if TYPE_CHECKING:
    from bus.fault import FaultInstance
    from plant.effects.camera.camera import Camera
    from plant.faults.base import PlantFault
    from plant.faults.schedule import FaultSchedule
    from plant.observations import Event
    from plant.plant import Plant


@final
class PlantProcess:
    """Tick loop of a run: plant and bus in lockstep, in one blocking thread.

    In tick k the cells receive what they sense at ``t_k = k tick_ns`` and answer with the drives that act on
    the whole of ``[t_k, t_(k+1))``, or of the tick ``drive_ticks`` later; the last interval ends with the run and may
    be shorter. No drive is expected of a cell after its death, scheduled or not; its wheels follow the stall policy
    from that tick on. With local clocks, a cell receives at t_k its last reading, and its drive acts from an instant
    within ``[t_k, t_(k+1))`` on.

    Args:
        plant: At time 0.
        coordinator: The lockstep, past its barrier.
        clock: Ticks, duration and pace.
        deaths: Scheduled deaths, and the consequences of deaths of any kind.
        hooks: Called around every tick.
        faults: Faults that begin and end during the run; None: there are none.
        camera: Camera whose frames the cells get; None: there is none.

    Attributes:
        hooks: As given; may be added to between ticks.
        pace: Waits until a tick, given its start in ns of simulated time, is due; None: ticks run as fast as possible.
            Called before anything of the tick happens; may be replaced between ticks.
        tick: The tick that is under way, or the next.
        time_ns: Simulated time reached.
        waiting: Whether the process waits for the cells or the clock: an exception raised by a signal handler
            at such a time leaves the plant at ``time_ns``, with every tick before it reported.
    """

    state_fields: ClassVar[StateFields] = StateFields(
        "_plant",
        "_sense",
        "_state",
        "_drives",
        "_faults",
        "_dead",
        "_camera",
        "_timing",
        "_delayed",
        "_gathered",
        "tick",
        "time_ns",
        records=(Sense,),
    )

    def __init__(
        self,
        plant: Plant,
        coordinator: LockstepPort,
        clock: RunClock,
        deaths: DeathPolicy,
        hooks: TickHooks | None = None,
        *,
        faults: FaultSchedule | None = None,
        camera: Camera | None = None,
    ) -> None:
        stall = deaths.stall
        self._plant = plant
        self._coordinator = coordinator
        self._clock = clock
        self._deaths = deaths
        self._timing = clock.timing
        self._camera = camera
        self._abort = stall.policy == "abort"
        self._sense = plant.sense()
        self._state = plant.state
        n = len(self._sense.presence)
        self._drives: Floats = np.zeros((n, 2))
        self._delayed = DelayedDrives(n, clock.drive_ticks) if clock.drive_ticks else None
        self._gathered = 0
        """First tick whose drives have not been gathered; only counted where drives are delayed."""
        self._lookahead = coordinator.lookahead if clock.drive_ticks else 0
        self._faults = faults
        self._dead = DeadCells(
            plant, n, "coast" if stall.policy == "abort" else stall.policy, deaths.wheel_policies
        )
        self._over: TickRecord | None = None
        self.hooks = TickHooks() if hooks is None else hooks
        self.pace = clock.pace
        self.tick = 0
        self.time_ns = 0
        self.waiting = False

    def run(self) -> LoopResult:
        """Run to the end of the duration, or to the first loss that ends the run.

        Raises:
            PlantError: The plant could not advance.
            BusError: The bus broke.
        """
        while True:
            ended = self.step()
            if ended is not None:
                return ended

    def step(self) -> LoopResult | None:
        """Run one tick; see ``run``.

        Returns:
            How the run ended; None while there is more of it. The last tick is reported by then.
        """
        if self.time_ns >= self._clock.duration_ns:
            return self._end()
        if self.pace is not None:
            self.report()
            with self.idle():
                self.pace(self.time_ns)
        for before_tick in self.hooks.before_tick:
            before_tick(self.tick)
        if self._abort and (dying := self._dying()):
            self.report()
            return LoopResult("failed", died=dying)
        losses = self._step()
        return self._ended(losses) if losses else None

    def _end(self) -> LoopResult:
        """Return the result of a run that has reached its duration."""
        if self._delayed is None:
            self.report()
            return LoopResult("failed", nobody=True) if self._nobody() else LoopResult("ok")
        self.catch_up()
        self.report()
        losses = self._delayed.in_flight
        ended = self._ended(losses) if losses else None
        if ended is not None:
            return ended
        return (
            LoopResult("failed", tuple(losses), nobody=True)
            if self._nobody()
            else LoopResult("ok", tuple(losses))
        )

    def _ended(self, losses: Sequence[Loss]) -> LoopResult | None:
        """How the run ends with these losses; None: it goes on."""
        failed = tuple(loss for loss in losses if loss.reason == "failed")
        if failed and self._deaths.stops_on_failure:
            return LoopResult("failed", tuple(losses), failed=failed)
        if self._abort:
            stalled = all(loss.reason == "timed_out" for loss in losses)
            return LoopResult("stalled" if stalled else "failed", tuple(losses))
        return None

    def _nobody(self) -> bool:
        """Whether all cells are dead or removed, at least one of them against the scene's schedule."""
        gone = self._dead.mask
        if gone is None or not gone.all():
            return False
        ordered = np.zeros(len(gone), dtype=np.bool_)
        for tick, cells in self._deaths.schedule.items():
            if tick < self.tick:
                ordered[list(cells)] = True
        if self._faults is not None:
            wheel_faults = self._faults.state_at(self.tick - 1, live=False)
            ordered |= wheel_faults.dead | wheel_faults.gone
        return not ordered.all()

    def revive(self, cells: Sequence[int]) -> None:
        """Readmit lost cells from the next tick on."""
        self._dead.revive(cells)

    def inject(self, fault: FaultInstance[PlantFault]) -> None:
        """Add a fault, which acts from the next tick on at the earliest."""
        if self._faults is None:
            from plant.faults.schedule import FaultSchedule

            self._faults = FaultSchedule(len(self.lost))
        self._faults.add(fault)
        self.replan()

    def place_parcel(self, parcel: int, pose: Floats) -> None:
        """Put a parcel at rest elsewhere, between two ticks; see ``plant.plant.Plant.place_parcel``."""
        self.report()
        self._plant.place_parcel(parcel, pose)
        self._state, self._sense = self._plant.state, self._plant.last_readings

    def replan(self) -> None:
        """Update the fault schedule after a fault's end tick has changed."""
        if self._faults is not None:
            self._faults.plan(self.tick)

    def _step(self) -> Sequence[Loss]:
        """Run one tick, and return the cells that were found lost.

        Losses that end the run leave the plant at the start of the tick.
        """
        tick, start_ns, sense, plant = self.tick, self.time_ns, self._sense, self._plant
        if self._faults is not None and tick >= self._faults.next_transition:
            self._turn(self._faults, tick)
            sense = self._sense
        died = self._deaths.schedule.get(tick, ()) if self._deaths.schedule else ()
        if died:
            died = self._dead.mark_dead(died, self._drives)
        drives, losses = self._exchange(tick, sense, died)
        if losses:
            if self._ended(losses):
                return losses
            self._dead.mark_dead([loss.cell for loss in losses], self._drives)
        drives = self._dead.override_drives(drives)
        until_ns = min(start_ns + self._clock.tick_ns, self._clock.duration_ns)
        before, wheel_speed = self._state, plant.wheel_speed
        self._sense, events = self._advance(tick, drives, until_ns)
        acted = self._drives.view()
        acted.setflags(write=False)  # the wheels go on by this array
        self.tick, self.time_ns, self._state = tick + 1, until_ns, plant.state
        self._over = TickRecord(
            tick,
            start_ns,
            until_ns,
            sense,
            wheel_speed,
            before,
            acted,
            self._state,
            events,
            died,
            losses,
        )
        return losses

    def _advance(self, tick: int, drives: Floats, until_ns: int) -> tuple[Sense, list[Event]]:
        """Advance the plant through a tick."""
        if self._timing is None:
            self._drives = drives
            return self._plant.advance(drives, until_ns, owned=True)
        acts_ns, reads_ns = self._timing(tick)
        if self._delayed is not None:
            acts_ns = self._delayed.delay_instants(acts_ns, self._clock.tick_ns)
        if self._dead.mask is not None:
            acts_ns = np.where(self._dead.mask, -1, acts_ns)
        # The last tick may be over before a drive would have acted: its wheels go on as they were.
        late = acts_ns >= until_ns
        self._drives = np.where(late[:, None], self._drives, drives)
        timing = Timing(np.where(late, -1, acts_ns), np.where(reads_ns < until_ns, reads_ns, -1))
        return self._plant.advance(self._drives, until_ns, timing, owned=True)

    def _exchange(self, tick: int, sense: Sense, died: tuple[int, ...]) -> tuple[Floats, Sequence[Loss]]:
        """Publish the sensor readings, and gather the drives and the losses of a tick.

        Cells that die in this tick still receive readings: the start of a tick confirms to a cell that its earlier
        messages have arrived. The previous tick is reported while the cells compute.
        """
        picture = None
        if self._camera is not None:
            picture = self._camera.capture(tick, self._state, self._plant.on_surface)
        self._coordinator.publish(
            SenseFrame(tick, sense.presence, sense.encoder_m, sense.level, sense.label, picture)
        )
        if died:
            self._coordinator.mark_dead(died, tick)
        self.report()
        delayed = self._delayed
        if delayed is not None:
            self._gather(delayed, tick - self._lookahead)
            if self._dead.mask is not None:
                delayed.mark_dead(self._dead.mask, tick)
            return delayed.take(tick)
        with self.idle():
            frame, losses = self._coordinator.gather(tick)
        return frame.drive, losses

    def _gather(self, delayed: DelayedDrives, tick: int) -> None:
        """Gather the drives of ``tick`` into those that are delayed."""
        if tick < self._gathered:
            return
        with self.idle():
            frame, losses = self._coordinator.gather(tick)
        self._gathered = tick + 1
        delayed.put(frame.drive, losses)

    def catch_up(self) -> None:
        """Gather the drives of all senses that were published, where the plant is ahead of them; between two ticks."""
        if self._delayed is not None:
            for tick in range(self._gathered, self.tick):
                self._gather(self._delayed, tick)

    @contextmanager
    def idle(self) -> Generator[None]:
        """Mark the process as waiting inside the context."""
        self.waiting = True
        try:
            yield
        finally:
            self.waiting = False

    def report(self) -> None:
        """Hand the record of the last tick to the hooks, once."""
        record, self._over = self._over, None
        if record is not None:
            for after_tick in self.hooks.after_tick:
                after_tick(record)

    def _dying(self) -> tuple[int, ...]:
        """Return the cells that die as the next tick begins."""
        dying = set(self._deaths.schedule.get(self.tick, ()))
        if self._faults is not None and self.tick >= self._faults.next_transition:
            dying.update(self._dead.about_to_die(self._faults.state_at(self.tick)))
        return tuple(sorted(dying))

    def _turn(self, faults: FaultSchedule, tick: int) -> None:
        """Apply the fault state after the transitions at ``tick``."""
        if self._dead.on_transition(faults.at_transition(tick), self._drives):
            self._sense = self._plant.last_readings

    @property
    def lost(self) -> NDArray[np.bool_]:
        """Whether each cell is dead for good, ``(n,)``."""
        return self._dead.lost

    @property
    def sense(self) -> Sense:
        """Sensor readings for the next tick."""
        return self._sense
