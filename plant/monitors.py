"""Event log and rest detector: conversion of solver results to plant events and parcel states."""

from __future__ import annotations

from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant.array import CellArray
from plant.errors import PlantHalted, PlantStopped, PlantUnstable
from plant.observations import Event, Floats, ParcelState, ParcelStatus
from plant.solver_api import AdvanceResult, Solver
from plant.specs import PlantSpec
from plant.stiffness import beyond_steps

WHY = {
    "no_step": "the integrator finds no step short enough for its tolerance",
    "no_loads": "no set of loads balances the parcel; this is a bug",
    "not_solved": "a step's problem was not solved to rounding; this is a bug",
}
"""Endings in words."""


@final
class EventLog:
    """Converts solver results to events and parcel states. Stops parcels that tip.

    Args:
        array: the cells.
        solver: solver that holds the parcels' states; tipping parcels are stopped there.
        status: status of each parcel, changed when the parcel tips.
        spec: the scene's physics including fed parcels, used to explain why a motion is hard to integrate.

    Attributes:
        support_changes: changes of support sets so far.
        left_out: events that solvers found and did not list so far.
        outrun_s: time at which each parcel first outran a wheel that its law assumes to be faster, ``(m,)``, s; NaN:
            never.
        halted: first error that ended a parcel's motion; None: no error.
    """

    state_fields: ClassVar[StateFields] = StateFields("support_changes", "left_out", "outrun_s")

    def __init__(self, array: CellArray, solver: Solver, status: list[ParcelStatus], spec: PlantSpec) -> None:
        self._array, self._solver, self._status, self._spec = array, solver, status, spec
        self.support_changes = 0
        self.left_out = 0
        self.outrun_s: Floats = np.full(len(status), np.nan)
        self.halted: PlantHalted | None = None

    def tipped(self, there: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the parcels among ``there`` that tipped and lie on the array."""
        return there[[self._status[int(i)].state == "tipped" for i in there]]

    def events(self, done: AdvanceResult, start_s: float) -> list[Event]:
        """Convert a parcel's advance result, of a move that began at ``start_s``, to events.

        If the motion can't be followed, or had to end, a ``halted`` event is added.
        """
        i = done.parcel
        self.support_changes += done.changes
        self.left_out += done.left_out
        names, places = self._array.lattice.cells, self._array.positions_m
        events = [
            Event(
                start_s + after_s, kind, i, (names[cell],), (places.item(2 * cell), places.item(2 * cell + 1))
            )
            if cell >= 0
            else Event(start_s + after_s, kind, i, (), self._place(i))
            for after_s, kind, cell in done.events
        ]
        if np.isnan(self.outrun_s[i]):
            self.outrun_s[i] = next((event.time_s for event in events if event.kind == "outrun"), np.nan)
        if done.termination == "tipped":
            self._solver.state[i, 3:] = 0.0
            events.append(self._tip(i, start_s + done.moved_s, done.edge))
        elif done.termination != "moving":
            self._halt(i, start_s + done.moved_s, done)
        return events

    def _place(self, i: int) -> tuple[float, float]:
        """Return the position of a parcel's centre of mass, m."""
        x, y = self._solver.state[i, :2].tolist()
        return x, y

    def _tip(self, i: int, time_s: float, edge: tuple[int, int]) -> Event:
        """Name the edge a parcel tips about; off the array where nothing lies beyond it."""
        state, place = self._solver.state[i], self._place(i)
        a, b = edge
        if a < 0:
            outcome, cells, detail = "off_array", (), "its last support left the footprint"
        else:
            cells = tuple(dict.fromkeys((self._array.lattice.cells[a], self._array.lattice.cells[b])))
            named = " and ".join(f"{row},{column}" for row, column in cells)
            outcome = "tipped" if self._array.cells_beyond(a, b, state[:2]) else "off_array"
            detail = f"about the line through cells {named}" if len(cells) == 2 else f"about cell {named}"
        self._status[i] = ParcelStatus(outcome, time_s, detail)
        return Event(time_s, outcome, i, cells, place, detail)

    def _halt(self, i: int, time_s: float, done: AdvanceResult) -> None:
        """Keep why a parcel's motion ended, if none ended before."""
        if self.halted is not None and self.halted.time_s <= time_s:
            return
        x, y = self._place(i)
        where = f"parcel {i} at t = {time_s:.6g} s, x = {x:.6g} m, y = {y:.6g} m"
        named = "the supports"
        if done.last_cell >= 0:
            named = "cell {},{}".format(*self._array.lattice.cells[done.last_cell])
        match done.termination:
            case "stopped":
                self.halted = PlantStopped(f"stopped on the way: {where}", time_s)
                return
            case "endless_changes":
                why = f"support changes without end, the last about {named}"
            case "endless_steps":
                why = beyond_steps(
                    self._spec, i, self._array.positions_m[self._solver.covered_cells(i)] - (x, y)
                )
            case ending:
                why = WHY.get(ending, "the motion is no longer finite")
        self.halted = PlantUnstable(f"{where}: {why}", time_s)


Numbers = NDArray[np.int64]


@final
class RestDetector:
    """Detects parcels at rest from sampled states.

    Args:
        radius: ``(m,)`` farthest corner of each parcel from its centre of mass, m.
        slow_m_s: a parcel none of whose corners moves faster, or gains speed faster than this a second, is at rest.
    """

    state_fields: ClassVar[StateFields] = StateFields("_resting")

    def __init__(self, radius: Floats, slow_m_s: float) -> None:
        from plant.kernels.exact import entry  # compiles or loads: only where a plant is really built

        self._entry: Any = entry
        self._radius, self._slow_m_s = radius, slow_m_s
        self._resting: NDArray[np.bool_] = np.zeros(len(radius), dtype=np.bool_)

    def any_changes(self, before: Floats, after: Floats, span_ns: int, which: Numbers) -> bool:
        """Whether `changes` has some for two states: else its work can be spared, which would be more than a tick's.

        Args:
            before: ``(m, 6)``.
            after: ``(m, 6)``.
            span_ns: Time between them.
            which: Parcels that are watched.
        """
        return self._entry.any_rest_change(
            before, after, span_ns * 1e-9, self._radius, self._resting, which, self._slow_m_s
        )

    def changes(
        self, states: Floats, times_ns: NDArray[np.int64], which: Numbers
    ) -> list[tuple[int, ParcelStatus]]:
        """Parcels that have come to rest or begun to move, and how they fare since when.

        Args:
            states: ``(T, m, 6)``.
            times_ns: ``(T,)`` instants of the states.
            which: Parcels that are watched.
        """
        if len(times_ns) < 2:
            return []
        scale = np.ones((len(which), 3))
        scale[:, 2] = self._radius[which]
        speed = states[:, which, 3:] * scale
        slow = np.max(np.abs(speed), axis=2) < self._slow_m_s
        span_s = np.diff(times_ns)[:, None] * 1e-9
        steady = np.max(np.abs(np.diff(speed, axis=0)), axis=2) < self._slow_m_s * span_s
        still = slow[1:] & slow[:-1] & steady
        at_end = still[-1]
        differs = still != at_end
        updates: list[tuple[int, ParcelStatus]] = []
        for k in np.flatnonzero((at_end != self._resting[which]) | np.any(differs, axis=0)).tolist():
            changed = np.flatnonzero(differs[:, k])
            since = changed[-1] + 1 if len(changed) else 0
            state: ParcelState = "at_rest" if at_end[k] else "moving"
            updates.append((int(which[k]), ParcelStatus(state, float(times_ns[since + at_end[k]]) * 1e-9)))
        self._resting[which] = at_end
        return updates
