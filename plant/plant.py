"""The plant: parcels on wheels, as a pure object with drives as input and sensor readings as output.

The plant has no clock of its own and no bus.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import TYPE_CHECKING, Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant.array import CellArray
from plant.errors import PlantError, PlantHalted
from plant.factories import make_scanners, make_spots, make_traffic, make_wheels
from plant.initial_checks import check_free, check_places, check_standing, check_stands
from plant.monitors import EventLog, RestDetector
from plant.observations import Event, ParcelStatus, Sense, TrafficCount, Trajectory
from plant.overlap import OverlapDetector, meeting
from plant.propagate import Propagator
from plant.sampling import SensorSampler, Timing
from plant.solver_api import Solver
from plant.solvers.compiled import CompiledSolver
from plant.solvers.registry import make_solver
from plant.specs import PlantSpec
from plant.wheels import Floats, LossPolicy, Wheels

if TYPE_CHECKING:
    from plant.effects.feeders.traffic import Traffic
    from plant.faults.base import WheelFaults


@final
class Plant:
    """Parcels on an array of cells, integrated from the wheels' motion.

    Args:
        spec: what the scene says of the physics.
        clock: time in s, for ``solver_s``; None: nothing is timed.

    Attributes:
        array: the cells.
        status: how each parcel fares: the scene's own in its order, then those that feeders bring.

    Raises:
        PlantError: a parcel doesn't stand on the array where it starts or is fed, or starts in an exit; or two overlap.
    """

    state_fields: ClassVar[StateFields] = StateFields(
        "_fault_state",
        "_wheels",
        "_solver",
        "_now_ns",
        "_chronicle",
        "_overlaps",
        "_rest",
        "_traffic",
        "_moves",
        "_last_readings",
        "_pending_events",
        shared=("status",),
        records=(Event, ParcelStatus, Sense),
    )

    def __init__(self, spec: PlantSpec, *, clock: Callable[[], float] | None = None) -> None:
        self.array: CellArray = CellArray(spec.array)
        n = len(self.array)
        self._motors = spec.effects.motors
        self._wheels: Wheels = make_wheels(spec, n)
        rate = 0.0 if self._motors is None else 1.0 / self._motors.first_order.time_constant_s
        self._solver: Solver = make_solver(spec.with_fed(), self.array, rate)
        self._spots = make_spots(spec, self.array)
        self._scanners = make_scanners(spec, self.array)
        self._now_ns = 0
        self._none: Floats = np.zeros(0)
        bodies = self._solver.bodies
        radius: Floats = np.array([body.radius_m for body in bodies])
        self.status: list[ParcelStatus] = [ParcelStatus("moving", 0.0) for _ in bodies]
        self._chronicle = EventLog(self.array, self._solver, self.status, spec.with_fed())
        self._overlaps = OverlapDetector([body.footprint_m for body in bodies], radius)
        self._rest = RestDetector(radius, spec.slow_m_s)
        check_standing(spec, self._solver, n)
        self._traffic = make_traffic(spec, self._solver, self.status, self._overlaps)
        there = np.arange(len(bodies)) if self._traffic is None else self._traffic.on_surface
        check_places(spec, self.state, self._overlaps, self._traffic)
        self._moves = Propagator(spec, self.array, self._solver, self._chronicle, there, clock)
        self._contact = self._moves.contact
        if self._contact is not None:
            self._contact.check_start(there)
        self._wheel_faults: WheelFaults | None = None
        self._last_readings: Sense | None = None
        """What each cell has read last."""
        self._pending_events = [] if self._traffic is None else self._update_traffic(self._traffic, 0)
        """What has happened since the last call."""

    @property
    def footprints_m(self) -> list[Floats]:
        """Corners ``(v, 2)`` of each parcel about its centre of mass, in its axes."""
        return [body.footprint_m.copy() for body in self._solver.bodies]

    @property
    def time_ns(self) -> int:
        """Simulated time."""
        return self._now_ns

    @property
    def state(self) -> Floats:
        """``(parcels, 6)``: x, y, theta, vx, vy, omega; a copy."""
        return self._solver.state.copy()

    @property
    def on_surface(self) -> NDArray[np.int64]:
        """Numbers of the parcels that neither wait to be fed nor have left through an exit, ascending."""
        return self._moves.on_surface

    @property
    def effort(self) -> int:
        """Work done by the solver: steps, or right-hand sides with ``scipy``."""
        return self._solver.effort

    @property
    def solver_s(self) -> float:
        """Time spent in calls of the solver so far, s, without sampling and bookkeeping; 0 without a clock."""
        return self._moves.solver_s

    @property
    def support_changes(self) -> int:
        """Changes of support sets so far."""
        return self._chronicle.support_changes

    @property
    def events_left_out(self) -> int:
        """Events of parcels so far that solvers found and did not list: too many of one parcel in one call."""
        return self._chronicle.left_out

    @property
    def outrun_s(self) -> Floats:
        """``(m,)`` when each parcel first outran a wheel that its law takes to be faster, s; NaN: never. Read-only."""
        return _read_only(self._chronicle.outrun_s)

    @property
    def captured(self) -> NDArray[np.bool_]:
        """``(m,)`` parcels whose chatter was captured so far: ``solver.capture_m`` governs their places."""
        return self._solver.captured

    @property
    def wheel_speed(self) -> Floats:
        """``(n, 2)`` surface speeds, m/s; read-only."""
        return _read_only(self._wheels.speed)

    def traffic(self) -> TrafficCount | None:
        """Return the traffic statistics up to now; None where the scene has no feeders."""
        return None if self._traffic is None else self._traffic.count(self._now_ns)

    def sense(self) -> Sense:
        """Read all cells' sensors now."""
        presence = np.zeros((len(self.array), len(self.array.sensors_m)), dtype=np.bool_)
        self._solver.presence(self._moves.on_surface, presence)
        travel = self._wheels.travel
        state, there = self._solver.state, self._moves.on_surface
        level = None if self._spots is None else self._spots.level(state, there)
        label = None if self._scanners is None else self._scanners.label(state, there)
        return Sense(presence, None if travel is None else _read_only(travel), level, label)

    def place_parcel(self, index: int, pose: Floats) -> None:
        """Put a parcel at rest elsewhere, between two calls; all cells read their sensors anew.

        Args:
            index: which parcel.
            pose: ``(3,)`` x, y in m, angle in rad.

        Raises:
            PlantError: there is no such parcel on the surface, it can't stand there, or it would overlap another
                parcel or a rail. Nothing has changed then.
        """
        if not 0 <= index < len(self.status) or index not in self._moves.on_surface:
            raise PlantError(f"parcel {index} is not on the surface")
        solver = self._solver
        if not isinstance(solver, CompiledSolver):
            raise PlantError(
                f"solver.name: {type(solver).__name__} can't put parcels elsewhere: use a compiled solver"
            )
        before = solver.snapshot(np.array([index]))
        solver.set_state(index, np.concatenate([pose, np.zeros(3)]))
        try:
            check_stands(solver, index, np.ones(len(self.array)), f"parcel {index}")
            check_free(self.state, index, self._overlaps, self._moves.on_surface)
            if self._contact is not None:
                self._contact.check_start(self._moves.on_surface)
        except PlantError:
            solver.restore(before)
            raise
        self.status[index] = ParcelStatus("moving", self._now_ns * 1e-9)
        if index not in self._moves.moving:
            self._moves.moving = np.sort(np.append(self._moves.moving, index))
        self._last_readings = self.sense()

    def warm_up(self) -> None:
        """Compile, or load, what calls with timing, and wheels that stop on the way, need beyond others."""
        self._moves.warm_up()

    def release_wheels(self, cells: Sequence[int], policy: LossPolicy) -> None:
        """Note that cells are dead from now on.

        A coasting wheel turns freely: it carries its load and pulls nothing. A braked or held one goes on acting
        on the drive it is given: zero, or the last.
        """
        if policy == "coast":
            self._moves.release(cells)

    def engage_wheels(self, cells: Sequence[int]) -> None:
        """Mark cells as alive again: their wheels follow drives."""
        self._moves.engage(cells)

    def apply_faults(self, wheel_faults: WheelFaults, drives: Floats) -> None:
        """Let faults do to wheels and cells, from now on, what they say; for dead cells see `lose`.

        Parcels over a cell that has gone or come stand on others at once, as the next call's events report.

        Args:
            wheel_faults: all that is the matter.
            drives: ``(n, 2)`` that stand until others take effect.
        """
        from plant.faults.faulty_wheels import FaultyWheels  # only where there are faults

        if not isinstance(self._wheels, FaultyWheels):
            self._wheels = FaultyWheels(self._wheels, self._motors, len(self.array))
        self._wheel_faults = wheel_faults
        self._wheels.apply_faults(wheel_faults, drives)
        self._moves.lock(wheel_faults.stuck[:, 0] & wheel_faults.stuck[:, 1])
        moved = self.array.keep(~wheel_faults.gone)
        if len(moved):
            self._rebuild(moved, wheel_faults.gone)

    @property
    def _fault_state(self) -> tuple[Any, ...] | None:
        """Last fault state, by the fields of ``WheelFaults``; None: no fault acted yet."""
        wheel_faults = self._wheel_faults
        return (
            None
            if wheel_faults is None
            else tuple(getattr(wheel_faults, field.name) for field in fields(wheel_faults))
        )

    @_fault_state.setter
    def _fault_state(self, saved: tuple[Any, ...] | None) -> None:
        """Restore wheels and cells under faults; motion within a tick is restored elsewhere."""
        if saved is not None:
            from plant.faults.base import WheelFaults

            self.apply_faults(WheelFaults(*saved), np.zeros((len(self.array), 2)))

    def _rebuild(self, cells: NDArray[np.int64], gone: NDArray[np.bool_]) -> None:
        """Cells have come to the array, or gone from it."""
        if self._scanners is not None:
            self._scanners.keep(~gone)
        for done in self._solver.on_array_changed(cells):
            if done.parcel in self._moves.moving:
                self._pending_events += self._chronicle.events(done, self._now_ns * 1e-9)
        now = self.sense()
        self._last_readings = (
            now if self._last_readings is None else self._last_readings.with_cells(cells, now)
        )

    @property
    def last_readings(self) -> Sense:
        """Last readings of each cell; all cells read at the start, and a rejoining cell when it rejoins."""
        return self._last_readings or self.sense()

    def advance(
        self, drives: Floats, until_ns: int, timing: Timing | None = None, *, owned: bool = False
    ) -> tuple[Sense, list[Event]]:
        """Move on to ``until_ns`` with constant drives.

        Args:
            drives: ``(n, 2)`` surface speeds in m/s, or volts where the scene has motors; finite.
            until_ns: not before now.
            timing: when each cell's drive takes effect and when it reads; None: all act now, and read at the end.
            owned: Whether the plant may keep ``drives``, to which nobody writes from now on, without a copy.

        Returns:
            What the cells sense then, or read last by then where each has its instant, and what happened on the way.

        Raises:
            PlantError: drives for another number of cells, a time in the past, or instants that are not in between.
            PlantUnstable: the motion of a parcel can't be followed. Parcels are where the call found them.
            PlantStopped: the call's end was requested; likewise.
        """
        reading = None
        if timing is not None:
            timing.check(len(self.array), self._now_ns, until_ns)
            reading = SensorSampler(self.last_readings, timing, self._now_ns, until_ns)
            if reading.any_at_start:
                reading.start(self.sense())
        acts_s = None if timing is None else timing.acts_s(self._now_ns)
        events = self._step(drives if owned else _copied(drives), until_ns, acts_s, reading)
        self._last_readings = self.sense() if reading is None else reading.sense(self.sense())
        return self._last_readings, events

    def _step(
        self,
        drives: Floats,
        until_ns: int,
        acts_s: Floats | None = None,
        reading: SensorSampler | None = None,
    ) -> list[Event]:
        """Move on, and take notice of what is the case then: see `advance`."""
        start_ns, before, status = self._now_ns, self.state, list(self.status)
        try:
            events = self._move(drives, until_ns, self._none, None, acts_s, reading)
        except PlantHalted as halted:
            self._chronicle.halted = halted
            self._put_back(before, start_ns, status)
            raise
        after = self.state
        if self._rest.any_changes(before, after, until_ns - start_ns, self._moves.moving):
            self._note_rest(np.stack([before, after]), np.array([start_ns, until_ns]))
        if self._pending_events:
            events, self._pending_events = [*self._pending_events, *events], []
        if self._traffic is not None:
            events += self._update_traffic(self._traffic, until_ns)
        if self._contact is None:
            events.extend(self._meetings(after, until_ns * 1e-9))
        return events

    def _update_traffic(self, traffic: Traffic, time_ns: int) -> list[Event]:
        """Let parcels leave and feed others, as they should by now."""
        events = traffic.update(time_ns)
        if events:
            there = traffic.on_surface
            self._moves.on_surface = there
            self._moves.moving = there[[self.status[int(i)].rides for i in there]]
        return events

    def trajectory(self, drives: Floats, until_ns: int, sample_ns: int) -> Trajectory:
        """Move on to ``until_ns`` in one go with constant drives, and sample the parcels every ``sample_ns``.

        Where parcels come and go, or push each other, it goes from sample to sample, as `advance` would.

        Raises:
            PlantUnstable: the motion of a parcel can't be followed. What all parcels reached is ``reached``, and
                parcels are where it ends.
            PlantStopped: the call's end was requested; likewise.
        """
        times = np.arange(self._now_ns, until_ns, sample_ns, dtype=np.int64)
        if len(times) == 0 or times[-1] != until_ns:
            times = np.append(times, until_ns)
        start_ns, drives = self._now_ns, _copied(drives)
        state = np.empty((len(times), len(self._solver.bodies), 6))
        state[0] = self.state
        if self._traffic is not None or (self._contact is not None and self._contact.resolves):
            return Trajectory(times, state, self._step_by_step(drives, times, state))
        after_s: Floats = (times[1:] - start_ns).astype(np.float64) * 1e-9
        status = list(self.status)
        try:
            events = [*self._pending_events, *self._move(drives, until_ns, after_s, state)]
        except PlantHalted as halted:
            # the sample at the very end may be of parcels that did not come so far
            known = max(1, int(np.searchsorted(times, math.floor(halted.time_s * 1e9))))
            self._put_back(state[known - 1], int(times[known - 1]), status)
            until_halt = [
                event for event in (*self._pending_events, *halted.events) if event.time_s <= halted.time_s
            ]
            halted.reached = self._noted(times[:known], state[:known], until_halt)
            raise
        self._pending_events = []
        return self._noted(times, state, events)

    def _noted(self, times: NDArray[np.int64], state: Floats, events: list[Event]) -> Trajectory:
        """A trajectory of parcels through some instants, with who rests and who overlaps on it."""
        self._note_rest(state, times)
        if self._contact is None:
            for k in self._overlaps.candidate_instants(state):
                events.extend(self._meetings(state[k], float(times[k]) * 1e-9))
        events.sort(key=lambda event: event.time_s)
        return Trajectory(times, state, events)

    def _put_back(self, state: Floats, time_ns: int, status: list[ParcelStatus]) -> None:
        """Have parcels ``(m, 6)`` where they were at an instant; ``status`` as it was when the call began."""
        self._solver.state[:] = state
        self._now_ns = time_ns
        for i, (now, before) in enumerate(zip(self.status, status, strict=True)):
            if now.time_s > time_ns * 1e-9:
                self.status[i] = before

    def _step_by_step(self, drives: Floats, times_ns: NDArray[np.int64], state: Floats) -> list[Event]:
        """Move on from instant to instant; fill ``state[1:]`` with the parcels' states there."""
        events: list[Event] = []
        for k, until_ns in enumerate(times_ns[1:].tolist(), start=1):
            try:
                events.extend(self._step(drives, until_ns))
            except PlantHalted as halted:
                halted.reached = Trajectory(times_ns[:k], state[:k], events)
                raise
            state[k] = self.state
        events.sort(key=lambda event: event.time_s)
        return events

    def _move(
        self,
        drives: Floats,
        until_ns: int,
        times_s: Floats,
        samples: Floats | None,
        acts_s: Floats | None = None,
        reading: SensorSampler | None = None,
    ) -> list[Event]:
        """Advance wheels and every parcel; fill ``samples[1:]`` with the states at ``times_s`` after now."""
        if np.shape(drives) != (len(self.array), 2):
            # the kernels don't look: they would read past the end
            raise PlantError(
                f"drives have shape {np.shape(drives)}: the array has {len(self.array)} cells of two wheels"
            )
        if until_ns < self._now_ns:
            raise PlantError(f"until_ns = {until_ns} is in the past: it is {self._now_ns} ns already")
        if self._chronicle.halted is not None:
            raise self._chronicle.halted
        span = (until_ns - self._now_ns) * 1e-9
        start = self._now_ns * 1e-9
        run = self._wheels.command(drives, span, acts_s)
        if samples is None:
            events = self._moves.advance(run, span, start, reading, self.sense)
        else:
            events = self._moves.sampled(run, span, start, times_s, samples[1:])
        if self._chronicle.halted is not None:
            self._chronicle.halted.events = events
            raise self._chronicle.halted
        passed = self._wheels.elapse(run, span, None if reading is None else reading.requested_s)
        if reading is not None:
            reading.set_encoders(passed)
        self._now_ns = until_ns
        return events

    def _note_rest(self, states: Floats, times_ns: NDArray[np.int64]) -> None:
        """Update ``status`` from the states ``(T, parcels, 6)`` at the instants ``(T,)``."""
        for i, status in self._rest.changes(states, times_ns, self._moves.moving):
            self.status[i] = status

    def _meetings(self, state: Floats, time_s: float) -> list[Event]:
        """Return events for parcels that began or ceased to overlap."""
        changes = self._overlaps.changes(state, self._moves.on_surface)
        return [meeting(time_s, *change) for change in changes]


def _copied(drives: Floats) -> Floats:
    """Return a copy of drives for the wheels to keep: a caller's array may change, or be read-only."""
    return np.array(drives, dtype=np.float64, order="C")


def _read_only(array: Floats) -> Floats:
    """Return a read-only view of an array."""
    view = array.view()
    view.setflags(write=False)
    return view
