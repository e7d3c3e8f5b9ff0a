"""Base class of solvers that restart a third-party integrator at each event.

Implemented in NumPy: cells under a parcel, load-carrying cells, and the loop around the integrator. The loop finds the
supports, integrates until an event function crosses zero, changes the cells under the parcel or the carrying cells, and
continues.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant import stop
from plant.array import CellArray
from plant.friction.law import Traction
from plant.kernel_data import body_of, cells_changed, find_members, make_parcel, members
from plant.kernels.common import layout
from plant.kernels.common.parcels import Parcel
from plant.loads import Supports, farthest_edge, find_supports
from plant.parcel_spec import ParcelSpec
from plant.solver_api import AdvanceResult, Body, Ending, Segment, SolverEvent
from plant.specs import PlantSpec
from plant.wheels import Floats

Cells = NDArray[np.int64]

CHANGES_PER_SECOND = 1_000
"""Changes of one parcel's supports in a simulated second beyond which its motion counts as unstable, ..."""
CHANGES_PER_MEMBER = 20
"""... plus this many for every cell that fits under it."""


class EndedError(ArithmeticError):
    """An integration came neither to an event nor to the leg's end.

    Args:
        ending: why.
        at_s: how far it came, the parcel's state being that of this instant; None: nowhere, the state is as it was.
    """

    def __init__(self, ending: Ending, at_s: float | None = None) -> None:
        super().__init__(ending)
        self.ending: Ending = ending
        self.at_s = at_s


@dataclass(slots=True)
class ParcelState:
    """One parcel.

    Attributes:
        shape: footprint, constants and state.
        mass_kg: of the parcel.
        under: ``(n,)`` cells under it.
        supports: those of them that carry it.
        allowed: changes of supports until its motion counts as unstable.
        effort_left: what the integrator may do until the motion is given up, counted as ``effort`` is.
        outrun: whether it outruns a wheel that the law takes to be faster.
    """

    state_fields: ClassVar[StateFields] = StateFields(
        "under", "supports", "allowed", "effort_left", "outrun", records=(Supports,)
    )

    shape: Parcel
    mass_kg: float
    under: Cells
    supports: Supports | None
    allowed: float
    effort_left: float
    outrun: bool = False

    def depth_m(self, points_m: Floats) -> Floats:
        """How far inside the footprint points ``(k, 2)`` lie; negative outside."""
        x, y, angle = self.shape.y[:3].tolist()
        c, s = np.cos(angle), np.sin(angle)
        body = (points_m - (x, y)) @ np.array([[c, -s], [s, c]])
        return np.min(self.shape.offset - body @ self.shape.normal.T, axis=1)


class IntegrationStop(NamedTuple):
    """Stop of an integration; the state is in the parcel.

    Attributes:
        at_s: time of the stop, s.
        crossed: cells on whose edge an event was found.
        loads: whether a load vanished or came back, or the centre of mass left a line of supports.
        noted: further events up to the stop.
    """

    at_s: float
    crossed: Cells
    loads: bool
    noted: Sequence[SolverEvent] = ()


class RestartingSolver(ABC):
    """A ``plant.solver_api.Solver`` but for the integration between two events.

    Args:
        scene: the scene's physics.
        array: the surface.
        effort_per_s: what the integrator may do for a parcel in a simulated second.

    Attributes:
        array: the surface.
        traction: the law.
        state: ``(m, 6)``.
        bodies: the parcels as the plant sees them.
        effort: steps, or evaluations of the right-hand side, so far: as its integrator counts.
    """

    state_fields: ClassVar[StateFields] = StateFields("effort", "_parcels", shared=("state",))

    def __init__(self, scene: PlantSpec, array: CellArray, effort_per_s: float) -> None:
        self.array = array
        self._effort_per_s = effort_per_s
        self.traction: Traction = scene.friction.traction()
        self.effort = 0
        self._gravity = scene.gravity_m_s2
        self.state: Floats = np.zeros((len(scene.parcels), 6))
        self._parcels: list[ParcelState] = [
            _moving(spec, array, self.state[i], effort_per_s) for i, spec in enumerate(scene.parcels)
        ]
        self.bodies: Sequence[Body] = [body_of(parcel.shape) for parcel in self._parcels]

    def weight_n(self, parcel: ParcelState) -> float:
        """Compute the total load on a parcel's supports, N."""
        return parcel.mass_kg * self._gravity

    @property
    def captured(self) -> NDArray[np.bool_]:
        """``(m,)``: these solvers capture no chatter."""
        return np.zeros(len(self._parcels), dtype=np.bool_)

    def spend(self, parcel: ParcelState, effort: int, at_s: float | None = None) -> None:
        """Count what the integrator does for a parcel; called between any two of its steps.

        Args:
            parcel: whose.
            effort: counted as ``effort`` is.
            at_s: see ``EndedError``.

        Raises:
            EndedError: it has done more than it may, or somebody asks for the call's end.
        """
        self.effort += effort
        parcel.effort_left -= effort
        if stop.requested():
            raise EndedError("stopped", at_s)
        if parcel.effort_left < 0.0:
            raise EndedError("endless_steps", at_s)

    def covered_cells(self, index: int) -> NDArray[np.int64]:
        """The cells under a parcel now, in no order, its boundary included."""
        return self._parcels[index].under

    def find_supports(self, index: int, grip: Floats) -> bool:
        """Compute a parcel's loads at its start. False if the supports can't carry the parcel."""
        del grip  # a wheel that turns freely carries all the same
        parcel = self._parcels[index]
        return self._find_supports(parcel)

    def on_array_changed(self, cells: NDArray[np.int64]) -> list[AdvanceResult]:
        """Find supports again where cells were added or removed; see ``plant.solver_api.Solver``."""
        results: list[AdvanceResult] = []
        for i, parcel in enumerate(self._parcels):
            changes = cells_changed(parcel.shape, parcel.under, cells, self.array)
            if changes:
                find_members(parcel.shape, self.array)
                parcel.under, parcel.supports = members(parcel.shape), None
                results.append(AdvanceResult(i, 0.0, "moving", (-1, -1), -1, len(changes), changes))
        return results

    def presence(self, indices: NDArray[np.int64], bits: NDArray[np.bool_]) -> None:
        """Set the presence bits ``(n, sensors)`` under those parcels."""
        numbers: list[int] = indices.tolist()
        for parcel in (self._parcels[index] for index in numbers):
            reach = 1.01 * float(parcel.shape.par[layout.RADIUS]) + self.array.sensor_reach_m
            near = self.array.near(parcel.shape.y[:2], reach)
            sensors = self.array.positions_m[near, None] + self.array.sensors_m
            # a sensor exactly under the edge is covered: the edge of a parcel at rest must not flicker
            covered = parcel.depth_m(sensors.reshape(-1, 2)) >= -4.0 * parcel.shape.par[layout.ON_SURFACE]
            bits[near] |= covered.reshape(sensors.shape[:2])

    def advance(self, indices: NDArray[np.int64], leg: Segment) -> list[AdvanceResult]:
        """Move some parcels, one after another; see ``plant.solver_api.Solver``."""
        done = [self._advance_one(i, leg._replace(out=leg.out[:, i])) for i in indices.tolist()]
        return [one for one in done if one.termination != "moving" or one.events]

    def _advance_one(self, index: int, leg: Segment) -> AdvanceResult:
        """Advance one parcel and write its sampled states to ``leg.out`` ``(k, 6)``."""
        parcel, now = self._parcels[index], 0.0
        ending: Ending = "moving"
        events: list[SolverEvent] = []
        refill = CHANGES_PER_SECOND + CHANGES_PER_MEMBER * len(parcel.shape.mem)
        parcel.allowed = min(parcel.allowed, refill) + refill * leg.span_s
        if parcel.supports is None:
            self._find_supports(parcel)
        with np.errstate(all="ignore"):  # what overflows shows in its state
            while now < leg.span_s:
                before = now
                ending, now = self._next(parcel, leg, now, events)
                # time gives back what it may take, up to one second's worth
                effort = parcel.effort_left + self._effort_per_s * (now - before)
                parcel.effort_left = min(effort, self._effort_per_s)
                if ending != "moving":
                    break
        leg.out[leg.times_s > now] = parcel.shape.y
        changes = sum(event.kind != "outrun" for event in events)
        last = events[-1].cell if events else -1
        return AdvanceResult(index, now, ending, self._edge(parcel), last, changes, events)

    @abstractmethod
    def _integrate(self, parcel: ParcelState, leg: Segment, now_s: float) -> IntegrationStop:
        """Integrate on the present supports from ``now_s`` until an event, or the leg's end.

        Takes the parcel's state there and fills the rows of ``leg.out`` ``(k, 6)`` whose ``times_s`` lie in between.
        Times count from the start of the leg.

        Raises:
            EndedError: a rate is no number, no step is short enough, there were too many, or it was to end.
        """

    def _next(
        self, parcel: ParcelState, leg: Segment, now_s: float, events: list[SolverEvent]
    ) -> tuple[Ending, float]:
        """To the next event, and over it. Returns (how it stands then, when)."""
        if parcel.supports is None:
            return "tipped", now_s
        try:
            reached = self._integrate(parcel, leg, now_s)
        except EndedError as ended:
            return ended.ending, now_s if ended.at_s is None else ended.at_s
        events.extend(reached.noted)
        before = parcel.under, parcel.supports.carrying
        for cell in reached.crossed.tolist():
            self._cross(parcel, cell)
        stands = True
        if len(reached.crossed) or reached.loads:
            stands = self._find_supports(parcel)
            changes = self._changes(parcel, *before, reached.at_s)
            events.extend(changes)
            parcel.allowed -= max(len(changes), 1)
        ending: Ending = "moving" if stands else "tipped"
        return ("endless_changes" if parcel.allowed < 0.0 else ending), reached.at_s

    def _cross(self, parcel: ParcelState, cell: int) -> None:
        """A cell comes under the parcel, or leaves it."""
        if cell in parcel.under:
            stay = parcel.under != cell
            carrying = None if parcel.supports is None else parcel.supports.carrying[stay]
            parcel.under = parcel.under[stay]
        else:
            parcel.under = np.append(parcel.under, cell)
            carrying = None if parcel.supports is None else np.append(parcel.supports.carrying, True)
        if parcel.supports is not None and carrying is not None:
            parcel.supports = parcel.supports._replace(carrying=carrying)

    def _find_supports(self, parcel: ParcelState) -> bool:
        """Find which of the cells under a parcel carry it. False where none can."""
        carried = parcel.supports
        guess = np.ones(len(parcel.under), dtype=np.bool_) if carried is None else carried.carrying
        offsets = self.array.positions_m[parcel.under] - parcel.shape.y[:2]
        found = find_supports(offsets, guess, self.array.pitch_m)
        if found is not None:
            found = found._replace(centroid_m=found.centroid_m + parcel.shape.y[:2])
        parcel.supports = found
        return found is not None

    def _changes(
        self, parcel: ParcelState, under: Cells, carrying: NDArray[np.bool_], at_s: float
    ) -> list[SolverEvent]:
        """Compare supports and loads with the previous ones and return the changes as events."""
        now = parcel.under
        changes = [SolverEvent(at_s, "support_lost", int(cell)) for cell in np.setdiff1d(under, now)]
        changes += [SolverEvent(at_s, "support_gained", int(cell)) for cell in np.setdiff1d(now, under)]
        if parcel.supports is None:
            return changes
        carried = dict(zip(under.tolist(), carrying.tolist(), strict=True))
        for cell, carries in zip(now.tolist(), parcel.supports.carrying.tolist(), strict=True):
            if carried.get(cell, carries) != carries:
                changes.append(SolverEvent(at_s, "load_returned" if carries else "load_vanished", cell))
        return changes

    def _edge(self, parcel: ParcelState) -> tuple[int, int]:
        """The cells about which a parcel tips; -1 where nothing is under it, or it stands."""
        if parcel.supports is not None or not len(parcel.under):
            return -1, -1
        offsets = self.array.positions_m[parcel.under] - parcel.shape.y[:2]
        _, a, b = farthest_edge(offsets, self.array.pitch_m)
        return int(parcel.under[a]), int(parcel.under[b])


def _moving(spec: ParcelSpec, array: CellArray, state: Floats, effort: float) -> ParcelState:
    """A parcel at its start, which is stored in ``state`` ``(6,)``."""
    shape = make_parcel(spec, array)
    state[:] = shape.y
    shape = shape._replace(y=state)
    return ParcelState(shape, spec.mass_kg, members(shape), None, float(CHANGES_PER_SECOND), effort)
