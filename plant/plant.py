"""The plant: parcels on wheels, as a pure object. State in, drives in; state out, senses out; no clock, no bus."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Literal, final

import numpy as np
from numpy.typing import NDArray

from plant.array import CellArray
from plant.errors import PlantError, PlantUnstable
from plant.overlap import OverlapWatch
from plant.parts import make_mover, make_spots, make_traffic, make_wheels
from plant.reports import Event, ParcelStatus, Sense, TrafficCount, Trajectory
from plant.rest import RestWatch
from plant.solvers.registry import make_solver
from plant.solvers.solver import Advance, Leg, Solver
from plant.specs import PlantSpec
from plant.start import check_places, check_standing
from plant.wheels import Floats, Wheels

if TYPE_CHECKING:
    from plant.traffic import Traffic

LossPolicy = Literal["coast", "brake", "hold"]


@final
class Plant:
    """Parcels on an array of cells, integrated from the wheels' motion.

    Args:
        spec: what the scene says of the physics.

    Attributes:
        array: the cells.
        status: how each parcel fares: the scene's own in its order, then those that feeders bring.
        support_changes: changes of support sets so far.

    Raises:
        PlantError: a parcel doesn't stand on the array where it starts or is fed, or starts in an exit; or two overlap.
    """

    def __init__(self, spec: PlantSpec) -> None:
        self.array: CellArray = CellArray(spec.array)
        n = len(self.array)
        motors = spec.effects.motors
        self._wheels: Wheels = make_wheels(spec, n)
        rate = 0.0 if motors is None else 1.0 / motors.time_constant_s
        self._solver: Solver = make_solver(spec.with_fed(), self.array, rate)
        self._spots = make_spots(spec, self.array)
        self._grip: Floats = np.ones(n)
        self._now_ns = 0
        self._none: Floats = np.zeros(0)
        bodies = self._solver.bodies
        self._nothing: Floats = np.zeros((0, len(bodies), 6))
        radius: Floats = np.array([body.radius_m for body in bodies])
        self.status: list[ParcelStatus] = [ParcelStatus("moving", 0.0) for _ in bodies]
        self.support_changes = 0
        self._overlaps = OverlapWatch([body.footprint_m for body in bodies], radius)
        self._rest = RestWatch(radius)
        check_standing(spec, self._solver, n)
        self._traffic = make_traffic(spec, self._solver, self.status, self._overlaps)
        self._there: NDArray[np.int64] = (
            np.arange(len(bodies)) if self._traffic is None else self._traffic.there
        )
        """Parcels that neither wait to be fed nor have left through an exit."""
        check_places(spec, self.state, self._overlaps, self._traffic)
        self._live = self._there
        """Those of them that move: neither tipped nor off the array."""
        self._contact = make_mover(spec, self._solver)
        if self._contact is not None:
            self._contact.check_start(self._there)
        self._untold = [] if self._traffic is None else self._look(self._traffic, 0)

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
    def effort(self) -> int:
        """What the solver has done so far: steps, or right-hand sides with ``scipy``."""
        return self._solver.effort

    @property
    def wheel_speed(self) -> Floats:
        """``(n, 2)`` surface speeds, m/s; read-only."""
        return _read_only(self._wheels.speed)

    def traffic(self) -> TrafficCount | None:
        """What has come and gone until now; None where the scene has no feeders."""
        return None if self._traffic is None else self._traffic.count(self._now_ns)

    def sense(self) -> Sense:
        """What the cells sense now."""
        presence = np.zeros((len(self.array), len(self.array.sensors_m)), dtype=np.bool_)
        self._solver.presence(self._there, presence)
        travel = self._wheels.travel
        level = None if self._spots is None else self._spots.level(self._solver.state, self._there)
        return Sense(presence, None if travel is None else _read_only(travel), level)

    def lose(self, cells: Sequence[int], policy: LossPolicy) -> None:
        """Note that cells are dead from now on.

        A coasting wheel turns freely: it carries its load and pulls nothing. A braked or held one goes on acting
        on the drive it is given: zero, or the last.
        """
        if policy == "coast":
            self._grip = self._grip.copy()
            self._grip[list(cells)] = 0.0

    def advance(self, drives: Floats, until_ns: int) -> tuple[Sense, list[Event]]:
        """Move on to ``until_ns`` with constant drives.

        Args:
            drives: ``(n, 2)`` surface speeds in m/s, or volts where the scene has motors; finite.
            until_ns: not before now.

        Returns:
            What the cells sense then, and what happened on the way.

        Raises:
            PlantError: drives for another number of cells, or a time in the past.
            PlantUnstable: the motion of a parcel can't be followed.
        """
        events = self._step(drives, until_ns)
        return self.sense(), events

    def _step(self, drives: Floats, until_ns: int) -> list[Event]:
        """Move on, and take notice of what is the case then: see `advance`."""
        start_ns, before = self._now_ns, self.state
        events = self._move(drives, until_ns, self._none, None)
        after = self.state
        if self._rest.may_change(after, self._live):
            self._note_rest(np.stack([before, after]), np.array([start_ns, until_ns]))
        if self._traffic is not None:
            events = [*self._untold, *events, *self._look(self._traffic, until_ns)]
            self._untold = []
        if self._contact is None:
            events.extend(self._meetings(after, until_ns * 1e-9))
        return events

    def _look(self, traffic: Traffic, time_ns: int) -> list[Event]:
        """Let parcels leave and feed others, as they should by now."""
        events = traffic.look(time_ns)
        if events:
            self._there = traffic.there
            self._live = self._there[[self.status[int(i)].rides for i in self._there]]
        return events

    def trajectory(self, drives: Floats, until_ns: int, sample_ns: int) -> Trajectory:
        """Move on to ``until_ns`` in one go with constant drives, and look at the parcels every ``sample_ns``.

        Where parcels come and go, or push each other, it goes from sample to sample, as `advance` would.

        Raises:
            PlantUnstable: the motion of a parcel can't be followed.
        """
        times = np.arange(self._now_ns, until_ns, sample_ns, dtype=np.int64)
        if len(times) == 0 or times[-1] != until_ns:
            times = np.append(times, until_ns)
        start_ns = self._now_ns
        state = np.empty((len(times), len(self._solver.bodies), 6))
        state[0] = self.state
        if self._traffic is not None or (self._contact is not None and self._contact.resolves):
            return Trajectory(times, state, self._step_by_step(drives, times, state))
        after_s: Floats = (times[1:] - start_ns).astype(np.float64) * 1e-9
        events = self._move(drives, until_ns, after_s, state)
        self._note_rest(state, times)
        if self._contact is None:
            for k in self._overlaps.close_calls(state):
                events.extend(self._meetings(state[k], float(times[k]) * 1e-9))
        events.sort(key=lambda event: event.time_s)
        return Trajectory(times, state, events)

    def _step_by_step(self, drives: Floats, times_ns: NDArray[np.int64], state: Floats) -> list[Event]:
        """Move on from instant to instant; fill ``state[1:]`` with the parcels' states there."""
        events: list[Event] = []
        for k, until_ns in enumerate(times_ns[1:].tolist(), start=1):
            events.extend(self._step(drives, until_ns))
            state[k] = self.state
        events.sort(key=lambda event: event.time_s)
        return events

    def _move(self, drives: Floats, until_ns: int, times_s: Floats, samples: Floats | None) -> list[Event]:
        """Advance wheels and every parcel; fill ``samples[1:]`` with the states at ``times_s`` after now."""
        if np.shape(drives) != (len(self.array), 2):
            # the kernels don't look: they would read past the end
            raise PlantError(
                f"drives have shape {np.shape(drives)}: the array has {len(self.array)} cells of two wheels"
            )
        if until_ns < self._now_ns:
            raise PlantError(f"until_ns = {until_ns} is in the past: it is {self._now_ns} ns already")
        span = (until_ns - self._now_ns) * 1e-9
        start = self._now_ns * 1e-9
        # a copy: the wheels keep it, and whoever gave it may change it or have it read-only
        motion = self._wheels.command(np.array(drives, dtype=np.float64, order="C"))
        live = self._live
        out = self._nothing if samples is None else samples[1:]
        events: list[Event] = []
        leg = Leg(motion, self._grip, span, times_s, out)
        if self._contact is None:
            news = self._solver.advance(live, leg)
        else:
            fixed = self._there[[self.status[int(i)].state == "tipped" for i in self._there]]
            news = self._contact.advance(live, fixed, leg, start)
            events += self._contact.events()
        for done in news:
            events.extend(self._news(done, start, times_s, out))
        if samples is not None:
            over = np.setdiff1d(self._there, live)
            samples[1:, over] = self._solver.state[over]
        self._wheels.elapse(motion, span)
        self._now_ns = until_ns
        return events

    def _news(self, done: Advance, start: float, times_s: Floats, out: Floats) -> list[Event]:
        """Note what happened to a parcel in a move that began at ``start``."""
        i = done.parcel
        self.support_changes += done.changes
        names, places = self.array.lattice.cells, self.array.positions_m
        events = [
            Event(
                start + after_s, kind, i, (names[cell],), (places.item(2 * cell), places.item(2 * cell + 1))
            )
            if cell >= 0
            else Event(start + after_s, kind, i, (), self._place(i))
            for after_s, kind, cell in done.events
        ]
        if done.ending == "tipped":
            self._solver.state[i, 3:] = 0.0
            out[times_s > done.moved_s, i, 3:] = 0.0
            events.append(self._tip(i, start + done.moved_s, done.edge))
            self._live = self._live[self._live != i]
        elif done.ending != "moving":
            self._unstable(i, start + done.moved_s, done)
        return events

    def _place(self, i: int) -> tuple[float, float]:
        """Where a parcel's centre of mass is."""
        x, y = self._solver.state[i, :2].tolist()
        return x, y

    def _tip(self, i: int, time_s: float, edge: tuple[int, int]) -> Event:
        """Name the edge a parcel tips about; off the array where nothing lies beyond it."""
        state, place = self._solver.state[i], self._place(i)
        a, b = edge
        if a < 0:
            outcome, cells, detail = "off_array", (), "its last support left the footprint"
        else:
            cells = tuple(dict.fromkeys((self.array.lattice.cells[a], self.array.lattice.cells[b])))
            named = " and ".join(f"{row},{column}" for row, column in cells)
            outcome = "tipped" if self.array.cells_beyond(a, b, state[:2]) else "off_array"
            detail = f"about the edge from cell {named}" if len(cells) == 2 else f"about cell {named}"
        self.status[i] = ParcelStatus(outcome, time_s, detail)
        return Event(time_s, outcome, i, cells, place, detail)

    def _unstable(self, i: int, time_s: float, done: Advance) -> None:
        x, y = self._place(i)
        where = f"parcel {i} at t = {time_s:.6g} s, x = {x:.6g} m, y = {y:.6g} m"
        named = "the supports"
        if done.culprit >= 0:
            named = "cell {},{}".format(*self.array.lattice.cells[done.culprit])
        why = {
            "endless_changes": f"support changes without end, the last about {named}",
            "endless_steps": "no step is short enough for the tolerance, time after time",
            "no_loads": "no set of loads balances the parcel; this is a bug",
            "not_solved": "a step's problem was not solved to rounding; this is a bug",
        }
        raise PlantUnstable(f"{where}: {why.get(done.ending, 'the motion is no longer finite')}")

    def _note_rest(self, states: Floats, times_ns: NDArray[np.int64]) -> None:
        """Update ``status`` from the states ``(T, parcels, 6)`` at the instants ``(T,)``."""
        for i, status in self._rest.changes(states, times_ns, self._live):
            self.status[i] = status

    def _meetings(self, state: Floats, time_s: float) -> list[Event]:
        """Parcels that have come to overlap, and those that no longer do."""
        return [
            Event(
                time_s,
                kind,
                first,
                (),
                place,
                f"with parcel {second}" + (f", {depth:.3g} m deep" if depth else ""),
            )
            for kind, first, second, depth, place in self._overlaps.changes(state, self._there)
        ]


def _read_only(array: Floats) -> Floats:
    """The same numbers, which whoever gets them can't change in the plant."""
    view = array.view()
    view.setflags(write=False)
    return view
