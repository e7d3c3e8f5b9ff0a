"""Propagation of all parcels through a call: in one segment, in common segments, or in segments a parcel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant.array import CellArray
from plant.factories import make_mover, segmenting_solver
from plant.monitors import EventLog
from plant.observations import Event, Sense
from plant.sampling import SensorSampler
from plant.solver_api import AdvanceResult, Segment, SegmentedCall, SegmentingSolver, Solver
from plant.specs import PlantSpec
from plant.wheels import Floats, WheelIntegrator, WheelMotion, WheelRun

BESIDE_M = 1e-6
"""A cell this far outside the footprint may be under it to rounding."""


def reach_margins_m(states: Floats, radius_m: Floats, fastest_m_s: float, span_s: float) -> Floats:
    """How far beyond where its footprint is now a parcel's corners can be within a span, ``(m,)``.

    Traction only draws a parcel towards the wheels' speed. Its centre gains no more speed than its corners and the
    fastest wheels have together; twice that leaves room for what turns it on the way.

    Args:
        states: ``(m, 6)``.
        radius_m: ``(m,)`` farthest corner of each from its centre of mass.
        fastest_m_s: of the wheels.
        span_s: how long.
    """
    speed = np.hypot(states[:, 3], states[:, 4]) + radius_m * np.abs(states[:, 5])
    return 2.0 * (speed + fastest_m_s) * span_s + BESIDE_M


def cells_near(array: CellArray, states: Floats, reach_m: Floats) -> NDArray[np.bool_]:
    """``(n,)`` which cells, or their sensors, may come under one of the parcels.

    Args:
        array: the cells.
        states: ``(m, 6)`` of the parcels.
        reach_m: ``(m,)`` from their centres.
    """
    # wheels may have a width, and sensors a spot: a pitch across and a pitch round at most
    beside = array.pitch_m + array.sensor_reach_m
    near: NDArray[np.bool_] = np.zeros(len(array), dtype=np.bool_)
    for state, reach in zip(states, reach_m.tolist(), strict=True):
        cells = array.within(state[:2], reach + beside)
        away = array.positions_m[cells] - state[:2]
        near[cells[np.hypot(away[:, 0], away[:, 1]) <= reach + beside]] = True
    return near


def segment_ends_s(run: WheelRun, reads_s: Floats, near: NDArray[np.bool_], span_s: float) -> list[float]:
    """Return the ends of a call's segments, s after the call's start, ascending; the last is ``span_s``.

    Args:
        run: motion of all wheels.
        reads_s: times at which cells read sensors, ``(n,)``, s; infinite: not within the call.
        near: cells that can affect the parcels, ``(n,)``.
        span_s: span of the call, s.
    """
    changed = np.zeros(0) if run.changes is None else run.changes.after_s[:, near].ravel()
    found = np.unique(np.concatenate([changed, reads_s[near]]))
    return [*found[found < span_s].tolist(), span_s]


def _stopped() -> float:
    """The clock of a plant that isn't timed."""
    return 0.0


@final
class Propagator:
    """Advances parcels on wheels through calls of the plant.

    Args:
        spec: the scene's physics.
        array: the cells.
        solver: solver that moves parcels.
        chronicle: log that converts results to events.
        there: indices of parcels on the surface, ascending.
        clock: time in s, for ``solver_s``; None: nothing is timed.

    Attributes:
        solver_s: time spent in calls of the solver by ``clock``, s, those of touching parcels included.
        on_surface: parcels that have been fed and have not left through an exit.
        moving: parcels of ``on_surface`` that neither tipped nor left the array.
        driven: 1 for a driven cell, 0 for a cell whose wheels turn freely, ``(n,)``.
        contact: mover of touching parcels; None without parcel contact.
    """

    state_fields: ClassVar[StateFields] = StateFields(
        "on_surface", "moving", "driven", "_freed", "_jammed", "contact"
    )

    def __init__(
        self,
        spec: PlantSpec,
        array: CellArray,
        solver: Solver,
        chronicle: EventLog,
        there: NDArray[np.int64],
        clock: Callable[[], float] | None = None,
    ) -> None:
        self._clock = clock or _stopped
        self.solver_s = 0.0
        self.on_surface = there
        self.moving = there
        self.driven: Floats = np.ones(len(array))
        self._freed: NDArray[np.bool_] = np.zeros(len(array), dtype=np.bool_)
        self._jammed = self._freed
        self.contact = make_mover(spec, solver)
        self._array, self._solver, self._chronicle = array, solver, chronicle
        self._legs = segmenting_solver(spec, solver)
        self._radius_m: Floats = np.array([body.radius_m for body in solver.bodies])
        self._never_s: Floats = np.full(len(array), np.inf)
        self._none: Floats = np.zeros(0)
        self._nothing: Floats = np.zeros((0, len(solver.bodies), 6))

    def release(self, cells: Sequence[int]) -> None:
        """The wheels of these cells turn freely from now on, but for those that are jammed."""
        self._grip_again(cells, self._jammed, freed=True)

    def engage(self, cells: Sequence[int]) -> None:
        """The wheels of these cells are driven from now on."""
        self._grip_again(cells, self._jammed, freed=False)

    def lock(self, cells: NDArray[np.bool_]) -> None:
        """Both wheels of these cells ``(n,)`` are jammed from now on, and of no others."""
        self._grip_again((), cells, freed=False)

    def _grip_again(self, cells: Sequence[int], jammed: NDArray[np.bool_], *, freed: bool) -> None:
        self._freed, self._jammed = self._freed.copy(), jammed
        self._freed[list(cells)] = freed
        self.driven = np.where(self._freed & ~jammed, 0.0, 1.0)

    def advance(
        self,
        run: WheelRun,
        span_s: float,
        start_s: float,
        reading: SensorSampler | None,
        sense: Callable[[], Sense],
    ) -> list[Event]:
        """Move all parcels by a span.

        Args:
            run: of all wheels.
            span_s: how long.
            start_s: when it begins.
            reading: what cells read on the way; None: none does.
            sense: what all cells would read now.
        """
        whole = Segment(run.motion, self.driven, span_s, self._none, self._nothing)
        if reading is not None and not reading.any_inside:
            reading = None
        if run.changes is None and reading is None:
            return self._advance_segment(whole, start_s)
        if self._legs is not None:
            return self._each_segmented(self._legs, run, span_s, start_s, reading)
        return self._segmented(run, whole, start_s, reading, sense)

    def warm_up(self) -> None:
        """Compile or load the kernels of segmented calls."""
        if self._legs is None or not len(self.moving):
            return
        still: Floats = np.zeros((len(self._array), 2))
        seen = np.zeros((len(self._array), len(self._array.sensors_m)), dtype=np.bool_)
        none = np.zeros(len(self._radius_m))
        run = WheelRun(WheelMotion(still, still, 0.0))
        self._legs.advance_segmented(
            self.moving[:1], SegmentedCall(run, self.driven, 0.0, self._never_s, none, seen)
        )

    def sampled(
        self, run: WheelRun, span_s: float, start_s: float, times_s: Floats, out: Floats
    ) -> list[Event]:
        """Move all parcels by a span; fill ``out`` ``(k, m, 6)`` with their states at ``times_s`` after its start."""
        whole = Segment(run.motion, self.driven, span_s, times_s, out)
        return (
            self._advance_segment(whole, start_s)
            if run.changes is None
            else self._segmented(run, whole, start_s)
        )

    def _each_segmented(
        self,
        solver: SegmentingSolver,
        run: WheelRun,
        span_s: float,
        start_s: float,
        reading: SensorSampler | None,
    ) -> list[Event]:
        """Move every parcel through legs of its own."""
        array = self._array
        seen = np.zeros((len(array), len(array.sensors_m)), dtype=np.bool_)
        margin_m = (
            reach_margins_m(solver.state, self._radius_m, run.fastest_m_s, span_s) + array.sensor_reach_m
        )
        reads_s = self._never_s if reading is None else reading.instants_s
        if len(self.moving) < len(self.on_surface):
            # tipped ones stay where they are
            solver.presence(np.setdiff1d(self.on_surface, self.moving), seen)
        begun = self._clock()
        results = solver.advance_segmented(
            self.moving, SegmentedCall(run, self.driven, span_s, reads_s, margin_m, seen)
        )
        self.solver_s += self._clock() - begun
        if reading is not None:
            reading.set_presence(seen)
        return self._to_events(results, start_s)

    def _segmented(
        self,
        run: WheelRun,
        whole: Segment,
        start_s: float,
        reading: SensorSampler | None = None,
        sense: Callable[[], Sense] | None = None,
    ) -> list[Event]:
        """Move all parcels leg by leg: to the next instant at which a wheel near any changes, or a cell reads."""
        states, radius_m, span_s = (
            self._solver.state[self.on_surface],
            self._radius_m[self.on_surface],
            whole.span_s,
        )
        reach_m = radius_m + reach_margins_m(states, radius_m, run.fastest_m_s, span_s)
        near = cells_near(self._array, states, reach_m)
        reads_s = self._never_s if reading is None else reading.instants_s
        wheels, begin = WheelIntegrator(run), 0.0
        events: list[Event] = []
        for end in segment_ends_s(run, reads_s, near, span_s):
            first, last = np.searchsorted(whole.times_s, [begin, end], side="right").tolist()
            times_s, out = whole.times_s[first:last] - begin, whole.out[first:last]
            leg = Segment(wheels.begin(), self.driven, end - begin, times_s, out)
            events += self._advance_segment(leg, start_s + begin)
            if self._chronicle.halted is not None:
                break
            wheels.end(leg.motion, end)
            if reading is not None and sense is not None:
                reading.sample_at(end, sense(), wheels.slowed_m)
            begin = end
        return events

    def _advance_segment(self, leg: Segment, start_s: float) -> list[Event]:
        """Move all parcels by a leg that begins at ``start_s``."""
        live, begun = self.moving, self._clock()
        if self.contact is None:
            results, events = self._solver.advance(live, leg), []
        else:
            results = self.contact.advance(live, self._chronicle.tipped(self.on_surface), leg, start_s)
            events = self.contact.events()
        self.solver_s += self._clock() - begun
        events += self._to_events(results, start_s)
        if len(leg.times_s):
            for done in results:
                if done.termination == "tipped":
                    leg.out[leg.times_s > done.moved_s, done.parcel, 3:] = 0.0
            over = np.setdiff1d(self.on_surface, live)
            leg.out[:, over] = self._solver.state[over]
        return events

    def _to_events(self, results: Sequence[AdvanceResult], start_s: float) -> list[Event]:
        """Convert results of a move that began at ``start_s`` to events, and stop parcels that tipped."""
        events: list[Event] = []
        for done in results:
            events.extend(self._chronicle.events(done, start_s))
            if done.termination == "tipped":
                self.moving = self.moving[self.moving != done.parcel]
        return events
