"""The ``exact`` solver: event-driven, analytic between events, no crossing missed.

Between two changes of the support set, or of the branch of the law that some wheel is on, the motion is a Taylor
series (translation linear, rotation linear with polynomial coefficients), so a step is as long as the series is
accurate, and event times are isolated roots of polynomials. See ``plant/kernels``: ``series`` for the motion,
``events`` and ``roots`` for its events, ``loads`` for the unilateral normal forces, ``branches`` for wheels at the
limit of their traction, ``capture`` for chatter.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant.array import CellArray
from plant.friction.law import Traction
from plant.kernels.common import layout
from plant.kernels.exact.segments import CallSchedule, SegmentWorkspace
from plant.parcel_spec import ParcelSpec
from plant.solver_api import AdvanceResult, SegmentedCall
from plant.solver_specs import ExactSpec
from plant.solvers.compiled import MIN_WORK_PER_THREAD, AdvanceArgs, ThreadedSolver, ThreadWorkspace
from plant.wheels import Floats, WheelChanges, WheelMotion

Workspace = TypeVar("Workspace")

LEGS = 8
"""About how many legs a parcel has then: threads are worth waking for as many fewer parcels."""


class SegmentedCompiledSolver(ThreadedSolver[Workspace]):
    """A ``plant.solver_api.SegmentingSolver`` but for one block of parcels."""

    @abstractmethod
    def _segmented_block(
        self,
        workspace: ThreadWorkspace[Workspace],
        block: NDArray[np.int64],
        errand: AdvanceArgs,
        schedule: CallSchedule,
        hand: SegmentWorkspace,
    ) -> tuple[int, int]:
        """Move the parcels of a block through their legs; see ``_advance_block``."""

    def advance_segmented(self, indices: NDArray[np.int64], outing: SegmentedCall) -> list[AdvanceResult]:
        """Move some parcels, each through its own legs; see ``plant.solver_api.SegmentingSolver``."""
        motion, changes = outing.run.motion, outing.run.changes
        if changes is None:
            none = np.zeros((0, len(self._array), 2))
            changes = WheelChanges(none, none, none)
        schedule = CallSchedule(
            *changes, outing.reads_s, outing.margin_m, self._array.sensors_m, outing.presence
        )
        surface = self._surface(motion, outing.grip)
        errand = AdvanceArgs(surface, outing.span_s, np.zeros(0), np.zeros((0, len(self.parcels), 6)))

        def move(thread: int, share: slice) -> list[AdvanceResult]:
            workspace, hand = self.workspace(thread), _hand(motion, changes)
            return self._move(
                workspace,
                indices[share],
                lambda block: self._segmented_block(workspace, block, errand, schedule, hand),
            )

        shares = self.thread_pool.map_ranges(len(indices), move, MIN_WORK_PER_THREAD // LEGS)
        return [result for share in shares for result in share]


def _hand(motion: WheelMotion, changes: WheelChanges) -> SegmentWorkspace:
    """Scratch for one share of the parcels; what isn't written is never touched."""
    n = len(motion.steady)
    return SegmentWorkspace(
        steady=motion.steady.copy(),
        decay=motion.decay.copy(),
        when=np.empty(changes.after_s.size),
        which=np.empty(changes.after_s.size, dtype=np.int64),
        times=np.empty(n),
        cells=np.empty(n, dtype=np.int64),
        poses=np.empty((n, 1, 6)),
    )


EVENTS_PER_SECOND = 4_000
"""Changes of one parcel's supports in a simulated second beyond which its motion counts as unstable, ..."""
EVENTS_PER_MEMBER = 20
"""... plus this many for every cell that fits under it."""


LONGEST_MEMORY_S = 10.0
"""An error in velocity counts as the way it leads in no longer than this."""


class ExactWorkspace(NamedTuple):
    """Workspace of the kernels; one instance a thread."""

    where: NDArray[np.int8]
    segs: Floats
    grp: Floats
    ser: Floats
    matrix: Floats
    reply: Floats
    fraction: Floats
    change: Floats
    adds: Floats
    seconds: Floats
    scratch: Floats
    newton: Floats
    found: Floats
    g: Floats
    p: Floats
    q: Floats
    cells: NDArray[np.int64]
    edges: NDArray[np.int64]
    signs: NDArray[np.int64]
    saved: NDArray[np.int64]
    before: Floats
    last: NDArray[np.int64]
    earlier: Floats
    after: Floats
    state: Floats


def make_workspace(cells: int, capacity: int) -> ExactWorkspace:
    """Scratch for an array of ``cells`` cells and parcels that cover at most ``capacity`` of them."""
    found = max(64, 2 * capacity)
    return ExactWorkspace(
        where=np.zeros(cells, dtype=np.int8),
        segs=np.zeros((layout.MODES, layout.SEG_SIZE)),
        grp=np.zeros((layout.MAX_GROUPS, layout.GRP_SIZE)),
        ser=np.zeros((layout.SER_ROWS, layout.SER_COLUMNS)),
        matrix=np.zeros((layout.MAX_GROUPS, layout.MAX_GROUPS)),
        reply=np.zeros((4, layout.MAX_GROUPS)),
        fraction=np.zeros(layout.MAX_GROUPS),
        change=np.zeros(layout.MAX_GROUPS),
        adds=np.zeros((layout.MODES, 3)),
        seconds=np.zeros((layout.MODES, layout.MAX_GROUPS)),
        scratch=np.zeros((3, 4)),
        newton=np.zeros((8, 3)),
        found=np.zeros((found, 4)),
        g=np.zeros(layout.SER_COLUMNS),
        p=np.zeros(layout.SER_COLUMNS),
        q=np.zeros(layout.SER_COLUMNS),
        cells=np.zeros(found, dtype=np.int64),
        edges=np.zeros(found, dtype=np.int64),
        signs=np.zeros(found, dtype=np.int64),
        saved=np.zeros((capacity, layout.MEM_COLUMNS), dtype=np.int64),
        before=np.zeros(3),
        last=np.zeros((found, 3), dtype=np.int64),
        earlier=np.zeros(3),
        after=np.zeros(3),
        state=np.zeros(6),
    )


@final
class Exact(SegmentedCompiledSolver[ExactWorkspace]):
    """Advances parcels that don't touch, each by itself; a ``plant.solver_api.Solver``.

    Args:
        array: the surface.
        parcels: footprint, mass and start of each.
        traction: a law whose branches are polynomial: any that is not set-valued and takes each wheel by itself.
        gravity_m_s2: of the scene.
        rate: of the motors, 1/s; 0 without.
        spec: tolerance and capture.
    """

    state_fields: ClassVar[StateFields] = StateFields(shared=("_allowance",))

    def __init__(
        self,
        array: CellArray,
        parcels: tuple[ParcelSpec, ...],
        traction: Traction,
        gravity_m_s2: float,
        rate: float,
        spec: ExactSpec,
    ) -> None:
        from plant.kernels.exact import entry  # compiles or loads: only where a plant is really built
        from plant.kernels.exact.block import ALLOWANCE_SIZE, LEFT, PER_SECOND, STEPS_LEFT, STEPS_PER_SECOND

        super().__init__(array, parcels, rate)
        self._entry: Any = entry
        self._allowance: Floats = np.zeros((len(parcels), ALLOWANCE_SIZE))
        for given, parcel, allowance in zip(parcels, self.parcels, self._allowance, strict=True):
            set_law(parcel.par, traction, given.mass_kg, gravity_m_s2)
            parcel.par[layout.TOLERANCE] = spec.tolerance
            parcel.par[layout.CAPTURE] = spec.capture_m
            allowance[[LEFT, PER_SECOND]] = EVENTS_PER_SECOND + EVENTS_PER_MEMBER * len(parcel.mem)
            allowance[[STEPS_LEFT, STEPS_PER_SECOND]] = spec.max_steps_per_s

    def _make_workspace(self) -> ExactWorkspace:
        return make_workspace(len(self._array), self.capacity)

    def _memory(self) -> Sequence[NDArray[Any]]:
        return *super()._memory(), self._allowance

    def _advance_block(
        self, workspace: ThreadWorkspace[ExactWorkspace], block: NDArray[np.int64], errand: AdvanceArgs
    ) -> tuple[int, int]:
        surface, span_s, times_s, out = errand
        return self._entry.advance_block(
            surface,
            self.packed,
            workspace.work,
            self._stop,
            self._allowance,
            block,
            span_s,
            times_s,
            out,
            workspace.log,
            workspace.report,
        )

    def _segmented_block(
        self,
        workspace: ThreadWorkspace[ExactWorkspace],
        block: NDArray[np.int64],
        errand: AdvanceArgs,
        schedule: CallSchedule,
        hand: SegmentWorkspace,
    ) -> tuple[int, int]:
        return self._entry.advance_segmented(
            errand.surface,
            self.packed,
            workspace.work,
            self._stop,
            self._allowance,
            block,
            errand.span_s,
            schedule,
            hand,
            workspace.log,
            workspace.report,
        )


def set_law(par: Floats, traction: Traction, mass_kg: float, gravity_m_s2: float) -> None:
    """The law per kilogram of one parcel, as the layout has it, and how long its errors in velocity last.

    Args:
        par: the parcel's constants.
        traction: the law.
        mass_kg: of the parcel.
        gravity_m_s2: of the scene.
    """
    per_share, constant = traction.stiffness_per_load * gravity_m_s2, traction.stiffness / mass_kg
    push = traction.push_per_load * gravity_m_s2
    slope = per_share + constant
    limited = slope > 0.0 and not math.isinf(traction.limit)
    assert not traction.set_valued, "this is a bug: the spec lets exact solve a set-valued law"
    assert not limited or not (traction.isotropic or per_share), (
        "this is a bug: a law's ends are not polynomial"
    )
    # without resistance the scale is arbitrary: pushes are then of 1 m/s
    kappa = slope or push
    par[layout.KAPPA] = kappa
    par[layout.PER_SHARE] = per_share / kappa
    par[layout.CONSTANT] = constant / kappa
    par[layout.LIMIT_PER_SHARE] = traction.limit_per_load * gravity_m_s2 / kappa if limited else 0.0
    par[layout.LIMIT] = traction.limit / mass_kg / kappa if limited else math.inf
    par[layout.FREE_SPEED] = traction.free_speed
    par[layout.PUSH_PER_SHARE] = push / kappa
    damped = slope > 0.0 and not limited
    par[layout.MEMORY] = min(1.0 / kappa, LONGEST_MEMORY_S) if damped else LONGEST_MEMORY_S
    par[layout.GAP] = par[layout.MEMORY]
