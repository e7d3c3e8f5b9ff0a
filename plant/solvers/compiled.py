"""Base classes of solvers whose parcels live in the kernels' arrays."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import Any, ClassVar, Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant import stop
from plant.array import CellArray
from plant.kernel_data import (
    ENDINGS,
    LoggedEvents,
    SensorCover,
    body_of,
    cells_changed,
    find_members,
    make_parcel,
    members,
    pack,
)
from plant.kernels.common import layout
from plant.kernels.common.parcels import (
    CHANGES,
    LEFT_OUT,
    LOG_CAPACITY,
    LOGGED,
    MOVED,
    REPORT_SIZE,
    WHICH,
    Parcel,
    Parcels,
)
from plant.kernels.common.surface import Surface
from plant.parcel_spec import ParcelSpec
from plant.solver_api import AdvanceResult, Body, Segment, SolverEvent, SolverSnapshot
from plant.solvers.thread_pool import ThreadPool
from plant.wheels import Floats, WheelMotion


class CompiledSolver(ABC):
    """Abstract ``plant.solver_api.Solver`` on the kernels' arrays; subclasses implement the advance.

    Args:
        array: the surface.
        parcels: footprint, mass and start of each parcel.
        rate: rate of the motors, 1/s; 0 without motors.

    Attributes:
        packed: all parcels in common arrays.
        parcels: views of single parcels in ``packed``.
        capacity: maximum number of cells under a parcel.
        state: view of ``packed``, ``(m, 6)``.
        bodies: the parcels as the plant sees them.
    """

    state_fields: ClassVar[StateFields] = StateFields(
        shared=("packed.y", "packed.par", "packed.ctl", "packed.mem")
    )

    def __init__(self, array: CellArray, parcels: tuple[ParcelSpec, ...], rate: float) -> None:
        from plant.kernels.common import select as pick  # loads numba: only where a plant is really built

        self._array = array
        self.packed: Parcels = pack([make_parcel(parcel, array) for parcel in parcels])
        self.packed.par[:, layout.RATE] = rate
        kernels: Any = pick
        self.parcels: list[Parcel] = [
            kernels.parcel_view.py_func(self.packed, i) for i in range(len(parcels))
        ]
        self.capacity: int = max((len(parcel.mem) for parcel in self.parcels), default=1)
        self.state: Floats = self.packed.y
        self.bodies: Sequence[Body] = [body_of(parcel) for parcel in self.parcels]
        self._stop = stop.flag()
        self._still: Floats = np.zeros((len(array), 2))
        self._cover = SensorCover(array)

    @property
    def effort(self) -> int:
        """Steps of all parcels so far, those not accepted included."""
        return int(self.packed.ctl[:, layout.N_STEPS].sum())

    @property
    def captured(self) -> NDArray[np.bool_]:
        """``(m,)`` parcels whose chatter was captured so far."""
        return self.packed.ctl[:, layout.N_CAPTURES] > 0

    def covered_cells(self, index: int) -> NDArray[np.int64]:
        """The cells under a parcel now, in no order, its boundary included."""
        return members(self.parcels[index])

    def find_supports(self, index: int, grip: Floats) -> bool:
        """Compute a parcel's loads at its pose. False if the supports can't carry the parcel."""
        still = WheelMotion(self._still, self._still, 0.0)
        results = self.advance(np.array([index]), Segment.through(still, grip, 0.0, len(self.parcels)))
        return not results or results[0].termination == "moving"

    def _memory(self) -> Sequence[NDArray[Any]]:
        """Arrays with a row a parcel that moving it changes."""
        return self.packed.y, self.packed.par, self.packed.ctl

    def snapshot(self, indices: NDArray[np.int64]) -> SolverSnapshot:
        """Save all solver state that an advance of these parcels changes."""
        parcels = [self.parcels[int(i)] for i in indices]
        members = [parcel.mem[: int(parcel.ctl[layout.N_MEMBERS])].copy() for parcel in parcels]
        return SolverSnapshot(indices, [rows[indices] for rows in self._memory()], members)

    def restore(self, snapshot: SolverSnapshot) -> None:
        """Restore a snapshot bit for bit."""
        for rows, before in zip(self._memory(), snapshot.rows, strict=True):
            rows[snapshot.indices] = before
        parcels = [self.parcels[int(i)] for i in snapshot.indices]
        for parcel, before in zip(parcels, snapshot.members, strict=True):
            parcel.mem[: len(before)] = before

    def set_state(self, index: int, state: Floats) -> None:
        """Set a parcel's state ``(6,)``; cells under the parcel and loads are computed again."""
        parcel = self.parcels[index]
        parcel.y[:] = state
        self._find_again(parcel)

    def on_array_changed(self, cells: NDArray[np.int64]) -> list[AdvanceResult]:
        """Find supports again where cells were added or removed; see ``plant.solver_api.Solver``."""
        results: list[AdvanceResult] = []
        for i, parcel in enumerate(self.parcels):
            changes = cells_changed(parcel, members(parcel), cells, self._array)
            if changes:
                self._find_again(parcel)
                results.append(AdvanceResult(i, 0.0, "moving", (-1, -1), -1, len(changes), changes))
        return results

    def _find_again(self, parcel: Parcel) -> None:
        """Find the cells under a parcel, whatever was known of them."""
        parcel.ctl[[layout.N_GROUPS, layout.N_CROSSED]] = 0
        find_members(parcel, self._array)

    def presence(self, indices: NDArray[np.int64], bits: NDArray[np.bool_]) -> None:
        """Set the presence bits ``(n, sensors)`` under those parcels."""
        self._cover.mark(self.packed, indices, bits)

    @abstractmethod
    def advance(self, indices: NDArray[np.int64], leg: Segment) -> list[AdvanceResult]:
        """Move some parcels; see ``plant.solver_api.Solver``."""

    def _surface(self, motion: WheelMotion, grip: Floats) -> Surface:
        """The cells and their wheels for one call of a kernel."""
        return Surface(self._array.positions_m, self._array.grid, motion.steady, motion.decay, grip)

    def _done(self, index: int, moved_s: float, changes: int, events: Sequence[SolverEvent]) -> AdvanceResult:
        """Build the result of a kernel call for one parcel; ``changes``: number of support changes."""
        ctl: list[int] = self.packed.ctl[index].tolist()
        return AdvanceResult(
            index,
            moved_s,
            ENDINGS[ctl[layout.STATUS]],
            (ctl[layout.TIP_A], ctl[layout.TIP_B]),
            ctl[layout.CULPRIT],
            changes,
            events,
        )


Workspace = TypeVar("Workspace")

MIN_WORK_PER_THREAD = 32
"""Waking a thread costs as much as moving so many parcels by a tick, or one of them by a second."""
SENSED_WORTH_WAKING = 128
"""... and as much as looking for the sensors under so many."""


class AdvanceArgs(NamedTuple):
    """Arguments shared by all parcels of a call."""

    surface: Surface
    span_s: float
    times_s: Floats
    out: Floats


class ThreadWorkspace(NamedTuple, Generic[Workspace]):
    """Workspace of one thread.

    Attributes:
        work: scratch of the solver's kernels.
        log: ``(rows, 4)``: see ``plant.kernels.common.layout``.
        report: ``(m, REPORT_SIZE)``: see ``plant.kernels.common.parcels``.
    """

    work: Workspace
    log: Floats
    report: Floats


class ThreadedSolver(CompiledSolver, Generic[Workspace]):
    """Abstract ``plant.solver_api.Solver`` on a thread pool; subclasses advance one block of parcels.

    A parcel's result depends neither on the other parcels of its block nor on the thread.

    Args:
        array: the surface.
        parcels: footprint, mass and start of each parcel.
        rate: rate of the motors, 1/s; 0 without motors.

    Attributes:
        thread_pool: the thread pool.
    """

    def __init__(self, array: CellArray, parcels: tuple[ParcelSpec, ...], rate: float) -> None:
        super().__init__(array, parcels, rate)
        self.thread_pool = ThreadPool()
        self._workspaces: dict[int, ThreadWorkspace[Workspace]] = {}

    @abstractmethod
    def _make_workspace(self) -> Workspace:
        """Scratch for one thread."""

    @abstractmethod
    def _advance_block(
        self, workspace: ThreadWorkspace[Workspace], block: NDArray[np.int64], errand: AdvanceArgs
    ) -> tuple[int, int]:
        """Move the parcels of a block, as many as ``workspace.log`` is sure to have room for.

        Returns:
            How many of the block were moved, and how many rows of ``workspace.report`` were written.
        """

    def workspace(self, thread: int) -> ThreadWorkspace[Workspace]:
        """Return a thread's workspace, created on first use."""
        if thread not in self._workspaces:
            log, report = np.zeros((2 * LOG_CAPACITY, 4)), np.zeros((len(self.parcels), REPORT_SIZE))
            self._workspaces[thread] = ThreadWorkspace(self._make_workspace(), log, report)
        return self._workspaces[thread]

    def advance(self, indices: NDArray[np.int64], leg: Segment) -> list[AdvanceResult]:
        """Move some parcels; see ``plant.solver_api.Solver``."""
        errand = AdvanceArgs(self._surface(leg.motion, leg.grip), leg.span_s, leg.times_s, leg.out)

        def move(thread: int, share: slice) -> list[AdvanceResult]:
            workspace = self.workspace(thread)
            return self._move(
                workspace, indices[share], lambda block: self._advance_block(workspace, block, errand)
            )

        least = max(1, round(MIN_WORK_PER_THREAD / (1.0 + MIN_WORK_PER_THREAD * leg.span_s)))
        return [
            result for share in self.thread_pool.map_ranges(len(indices), move, least) for result in share
        ]

    def presence(self, indices: NDArray[np.int64], bits: NDArray[np.bool_]) -> None:
        """Set the presence bits ``(n, sensors)`` under those parcels."""

        def mark(_: int, share: slice) -> None:
            self._cover.mark(self.packed, indices[share], bits)

        self.thread_pool.map_ranges(len(indices), mark, SENSED_WORTH_WAKING)

    def _move(
        self,
        workspace: ThreadWorkspace[Workspace],
        block: NDArray[np.int64],
        advance: Callable[[NDArray[np.int64]], tuple[int, int]],
    ) -> list[AdvanceResult]:
        """Move a block, in as many calls as its events need. Returns the parcels to which something happened.

        Args:
            workspace: what the thread works with.
            block: which parcels.
            advance: moves the first of those given; see ``_advance_block``.
        """
        results: list[AdvanceResult] = []
        while len(block):
            moved, noted = advance(block)
            block = block[moved:]
            report: list[list[float]] = workspace.report[:noted].tolist()
            log = workspace.log[: int(sum(row[LOGGED] for row in report))].copy()
            first = 0
            for row in report:
                begin, first = first, first + int(row[LOGGED])
                events = LoggedEvents(log[begin:first])
                done = self._done(int(row[WHICH]), row[MOVED], int(row[CHANGES]), events)
                left_out = int(row[LEFT_OUT])
                # The last event, by which a parcel tips, is reported as the termination.
                as_termination = left_out > 0 and done.termination == "tipped"
                results.append(done._replace(left_out=left_out - as_termination))
        return results
