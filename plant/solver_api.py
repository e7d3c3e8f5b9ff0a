"""Interface between the plant and its solvers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from plant.wheels import Floats, WheelMotion, WheelRun

Ending = Literal[
    "moving",
    "tipped",
    "endless_changes",
    "endless_steps",
    "no_step",
    "no_loads",
    "not_solved",
    "not_finite",
    "stopped",
]


class Body(NamedTuple):
    """Parcel in a solver.

    Attributes:
        footprint_m: corners about the centre of mass, in the parcel's axes, counter-clockwise, ``(v, 2)``, m.
        radius_m: distance of the farthest corner from the centre of mass, m.
        state: x, y, theta, vx, vy, omega, ``(6,)``; owned by the solver and changed as the parcel moves.
    """

    footprint_m: Floats
    radius_m: float
    state: Floats


class SolverEvent(NamedTuple):
    """Event of one parcel during a call.

    Attributes:
        after_s: time after the start of the call, s.
        kind: one of ``plant.observations.Event.kind``.
        cell: index of the cell, or -1.
    """

    after_s: float
    kind: str
    cell: int


class AdvanceResult(NamedTuple):
    """Result of one parcel's advance.

    Attributes:
        parcel: index of the parcel.
        moved_s: time moved, s; less than requested after an early end.
        termination: ``moving``, or the reason for an early end.
        edge: the two cells about which the parcel tipped, the same twice for a corner, -1 without cells under the
            parcel.
        last_cell: cell of the last event, named in messages about endless changes, or -1.
        changes: number of support changes.
        events: logged events by ascending time, without tipping.
        left_out: number of further events for which a kernel's log had no room.
    """

    parcel: int
    moved_s: float
    termination: Ending
    edge: tuple[int, int]
    last_cell: int
    changes: int
    events: Sequence[SolverEvent]
    left_out: int = 0


class Segment(NamedTuple):
    """Time span over which parcels are advanced, with the wheels' motion.

    Attributes:
        motion: motion of all wheels, from the segment's start on.
        grip: 1 for a driven cell, 0 for a cell whose wheels turn freely, ``(n,)``.
        span_s: duration, s.
        times_s: times at which states are sampled, ``(k,)``, s, ascending, in ``(0, span_s]``.
        out: sampled states of the parcels, ``(k, m, 6)``; after an early end, the last state.
    """

    motion: WheelMotion
    grip: Floats
    span_s: float
    times_s: Floats
    out: Floats

    @classmethod
    def through(cls, motion: WheelMotion, grip: Floats, span_s: float, parcels: int) -> Segment:
        """Return a segment without sampled states; ``parcels`` is m."""
        return cls(motion, grip, span_s, np.zeros(0), np.zeros((0, parcels, 6)))


class SegmentedCall(NamedTuple):
    """Call in which wheels change and cells read sensors.

    Attributes:
        run: motion of all wheels.
        grip: as in ``Segment``, ``(n,)``.
        span_s: duration, s.
        reads_s: time at which each cell reads its sensors, ``(n,)``, s after the start; infinite: not within the call.
        margin_m: distance from a parcel's initial footprint within which a cell can drive the parcel or sense it,
            ``(m,)``, m.
        presence: presence bits, ``(n, sensors)``, set for sensors covered by an advanced parcel when their cell reads.
    """

    run: WheelRun
    grip: Floats
    span_s: float
    reads_s: Floats
    margin_m: Floats
    presence: NDArray[np.bool_]


class SolverSnapshot(NamedTuple):
    """Snapshot of a solver's state of some parcels.

    Attributes:
        indices: indices of the parcels.
        rows: rows of the parcels, from every array with a row a parcel.
        members: cells under each parcel, with the kernels' marks.
    """

    indices: NDArray[np.int64]
    rows: Sequence[NDArray[Any]]
    members: Sequence[NDArray[np.int64]]


class Solver(Protocol):
    """Solver that advances parcels independently, without contact between parcels.

    A solver knows the law of traction by its ``plant.friction.law.Traction`` only, and the wheels by their
    ``WheelMotion`` over an interval. Parcels are named by their number in the scene.
    """

    @property
    def bodies(self) -> Sequence[Body]:
        """The parcels, in the order of the scene."""
        ...

    @property
    def state(self) -> Floats:
        """``(m, 6)`` states of all parcels, the solver's own; its rows are those of ``bodies``."""
        ...

    @property
    def effort(self) -> int:
        """Work done so far, for all parcels together: steps, or evaluations of the right-hand side."""
        ...

    @property
    def captured(self) -> NDArray[np.bool_]:
        """``(m,)`` parcels whose chatter was captured so far: their places are right to ``capture_m``."""
        ...

    def covered_cells(self, index: int) -> NDArray[np.int64]:
        """The cells under a parcel now, in no order, its boundary included."""
        ...

    def find_supports(self, index: int, grip: Floats) -> bool:
        """Whether the cells under a parcel can carry it where it is.

        Args:
            index: which parcel.
            grip: ``(n,)`` 1 for a driven cell, 0 for one whose wheels turn freely.
        """
        ...

    def advance(self, indices: NDArray[np.int64], leg: Segment) -> list[AdvanceResult]:
        """Advance parcels in place; the result for each parcel doesn't depend on the other indices.

        Args:
            indices: indices of the parcels, unique, ``(b,)``.
            leg: segment to advance through, with its wheel motion.

        Returns:
            Results of parcels with events, changed supports or an early end, in the order of ``indices``. All other
            parcels moved through the whole segment on unchanged supports.
        """
        ...

    def on_array_changed(self, cells: NDArray[np.int64]) -> list[AdvanceResult]:
        """Find the supports of all parcels again after cells were added to or removed from the array.

        Args:
            cells: which.

        Returns:
            What that changed, for each parcel over one of them; which of its supports carry it is found as it moves.
        """
        ...

    def presence(self, indices: NDArray[np.int64], bits: NDArray[np.bool_]) -> None:
        """Set the presence bits ``(n, sensors)`` under some of the parcels."""
        ...


class Rewindable(Solver, Protocol):
    """Solver that can restore earlier states of parcels and set new ones, for effects between parcels."""

    def snapshot(self, indices: NDArray[np.int64]) -> SolverSnapshot:
        """Save all solver state that an advance of these parcels changes."""
        ...

    def restore(self, snapshot: SolverSnapshot) -> None:
        """Restore a snapshot bit for bit."""
        ...

    def set_state(self, index: int, state: Floats) -> None:
        """Set a parcel's state ``(6,)``; cells under the parcel and loads are computed again."""
        ...


class SegmentingSolver(Solver, Protocol):
    """Solver that divides a call into segments for each parcel, at wheel changes within its reach."""

    def advance_segmented(self, indices: NDArray[np.int64], outing: SegmentedCall) -> list[AdvanceResult]:
        """Move parcels as ``advance`` does, none hanging on which others are moved with it.

        Args:
            indices: ``(b,)`` which parcels, none twice.
            outing: how far, on which wheels, and who reads.
        """
        ...
