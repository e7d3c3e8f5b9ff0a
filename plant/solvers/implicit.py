"""The ``implicit`` solver: a convex problem of three unknowns a step, for any law of traction.

At given loads every law's force is the gradient of a convex potential of the slip. The velocity at the end of a step is
therefore the unique minimum of a strictly convex function, however stiff the law or set-valued its force. A parcel that
sticks does so exactly. See ``plant/kernels/implicit``: ``step`` for the problem, ``advance`` for the steps.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, ClassVar, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant.array import CellArray
from plant.friction.law import Traction
from plant.kernels.common import implicit_layout, layout
from plant.kernels.common.parcels import Parcel
from plant.solver_api import AdvanceResult, Segment
from plant.solver_specs import ImplicitSpec, QuasiStaticSpec
from plant.solvers.compiled import AdvanceArgs, ThreadedSolver, ThreadWorkspace
from plant.solvers.exact import make_workspace as make_event_workspace
from plant.solvers.exact import set_law
from plant.solvers.springs import (
    make_drag,
    make_edges,
    make_factors,
    make_rollers,
    make_springs,
    make_stiction,
    make_transfer,
)
from plant.solvers.wheel_load import WheelLoadSum, WheelLoadWorkspace, load_wheels, make_slowing
from plant.specs import PlantSpec
from plant.wheels import Floats

FIRST_STEP_S = 1e-3
"""What a controlled run tries first."""
UNBOUNDED = 1e300
"""More steps than any run has."""


class ImplicitWorkspace(NamedTuple):
    """Scratch of the kernels, one set a thread, with room for one parcel's law and pace."""

    law: Floats
    pace: Floats
    seg: Floats
    scratch: Floats
    newton: Floats
    wheels: Floats
    start: Floats
    velocity: Floats
    trial: Floats
    step: Floats
    rhs: Floats
    grad: Floats
    hessian: Floats
    begin: Floats
    end: Floats
    first: Floats
    begun: Floats
    error: Floats
    table: Floats
    saved: NDArray[np.int64]
    where: NDArray[np.int8]
    centroid: Floats
    planes: Floats
    normals: Floats
    ended: Floats
    segs: Floats
    grp: Floats
    ser: Floats
    matrix: Floats
    reply: Floats
    fraction: Floats
    change: Floats
    adds: Floats
    seconds: Floats
    found: Floats
    g: Floats
    p: Floats
    q: Floats
    cells: NDArray[np.int64]
    edges: NDArray[np.int64]
    signs: NDArray[np.int64]
    before: Floats
    last: NDArray[np.int64]
    earlier: Floats
    after: Floats
    state: Floats
    slowing: WheelLoadWorkspace | None = None


def make_workspace(cells: int, capacity: int) -> ImplicitWorkspace:
    """Scratch for an array of ``cells`` cells and parcels that cover at most ``capacity`` of them."""
    of_events = make_event_workspace(cells, capacity)
    return ImplicitWorkspace(
        **of_events._asdict(),
        seg=of_events.segs[0],
        centroid=np.zeros((layout.MODES, 2)),
        planes=np.zeros((layout.MODES, 3)),
        normals=np.zeros((layout.MAX_GROUPS, 3)),
        ended=np.zeros(3),
        law=np.zeros(implicit_layout.LAW_SIZE),
        pace=np.zeros(implicit_layout.PACE_SIZE),
        wheels=np.zeros((capacity * layout.MODES + 1, implicit_layout.WHEEL_SIZE)),
        start=np.zeros(3),
        velocity=np.zeros(3),
        trial=np.zeros(3),
        step=np.zeros(3),
        rhs=np.zeros(3),
        grad=np.zeros(3),
        hessian=np.zeros((3, 3)),
        begin=np.zeros(6),
        end=np.zeros(6),
        first=np.zeros(implicit_layout.FIRST_SIZE),
        begun=np.zeros(4),
        error=np.zeros(6),
        table=np.zeros((4, 6)),
    )


def coefficients(traction: Traction, mass_kg: float, gravity_m_s2: float) -> Floats:
    """A law per kilogram of one parcel, loads as shares of its weight; see ``plant.kernels.common.implicit_layout``."""
    law = np.zeros(implicit_layout.LAW_SIZE)
    law[implicit_layout.STIFFNESS] = traction.stiffness / mass_kg
    law[implicit_layout.STIFFNESS_PER_SHARE] = traction.stiffness_per_load * gravity_m_s2
    law[implicit_layout.LIMIT] = traction.limit / mass_kg
    law[implicit_layout.LIMIT_PER_SHARE] = traction.limit_per_load * gravity_m_s2
    law[implicit_layout.FREE_SPEED] = traction.free_speed
    law[implicit_layout.PUSH_PER_SHARE] = traction.push_per_load * gravity_m_s2
    law[implicit_layout.VISCOUS] = traction.viscous / mass_kg
    law[implicit_layout.SET_VALUED] = float(traction.set_valued)
    law[implicit_layout.ISOTROPIC] = float(traction.isotropic)
    law[implicit_layout.STATIC_RATIO] = traction.static_ratio
    return law


def steps_per_s(spec: ImplicitSpec | QuasiStaticSpec) -> float:
    """Steps that a parcel may take in a simulated second; where their length is given, as many as it takes."""
    return spec.max_steps_per_s if spec.step_s is None else UNBOUNDED


def first_pace(parcel: Parcel, spec: ImplicitSpec) -> Floats:
    """Settings and memory of one parcel's steps; see ``plant.kernels.common.implicit_layout``."""
    pace = np.zeros(implicit_layout.PACE_SIZE)
    pace[implicit_layout.GYRATION] = parcel.par[layout.MASS_OVER_INERTIA] ** -0.5
    pace[implicit_layout.FIXED] = spec.step_s or 0.0
    pace[implicit_layout.TOLERANCE] = spec.tolerance
    pace[implicit_layout.NEXT] = FIRST_STEP_S
    pace[[implicit_layout.STEPS_LEFT, implicit_layout.STEPS_PER_SECOND]] = steps_per_s(spec)
    return pace


def locate(
    law: Floats,
    pace: Floats,
    parcel: Parcel,
    traction: Traction,
    mass_kg: float,
    scene: PlantSpec,
    spec: ImplicitSpec,
) -> None:
    """Have one parcel's events located.

    So are those of its wheels under ``coulomb``, and under ``stick_slip`` on wheels that all share the law and run as
    motors drive them.
    """
    effects = scene.effects
    pace[implicit_layout.LOCATES] = 1.0
    parcel.par[layout.TOLERANCE] = spec.tolerance
    parcel.par[layout.CAPTURE] = spec.capture_m
    parcel.par[layout.LIMIT] = math.inf
    tall = effects.load_transfer is not None
    # nothing chatters where loads ramp; wheels that lag behind by the mean of their forces would shift no mode's loads
    chatters = effects.contact_width is None and not (tall and effects.wheel_load is not None)
    if traction.set_valued:
        parcel.par[layout.FREE_SPEED] = traction.free_speed
        law[implicit_layout.LOCATED] = implicit_layout.CONES
        if not traction.isotropic:
            # no slip is within the limit: each wheel sticks, or slips one way
            parcel.par[[layout.LIMIT, layout.LIMIT_PER_SHARE]] = 0.0
            law[implicit_layout.LOCATED] = implicit_layout.JUMPS
        if chatters:
            law[implicit_layout.CAPTURES] = implicit_layout.BY_STEPS
        return
    if not chatters:
        return
    if effects.wheel_load is not None:
        # with motors that the law doesn't have itself no wheel has branches
        law[implicit_layout.CAPTURES] = implicit_layout.BY_STEPS
        return
    kinks = math.inf not in (traction.limit, traction.limit_per_load) and (
        traction.stiffness > 0.0 or traction.stiffness_per_load > 0.0
    )
    # what the kernels of ``exact`` don't know of: where wheels change branch, and the motion along a surface
    known = effects.uneven_friction is None and effects.roller_drag is None and traction.viscous == 0.0
    if not tall:
        set_law(parcel.par, traction, mass_kg, scene.gravity_m_s2)
        if not known:
            parcel.par[layout.LIMIT] = math.inf
        law[implicit_layout.LOCATED] = float(parcel.par[layout.LIMIT] < math.inf)
    if known and not tall and effects.uneven_supports is None:
        law[implicit_layout.CAPTURES] = implicit_layout.BY_SERIES
    else:
        # without branches forces are linear in the loads
        law[implicit_layout.CAPTURES] = implicit_layout.BY_MODES if kinks else implicit_layout.BY_STEPS


@final
class Implicit(ThreadedSolver[ImplicitWorkspace]):
    """Advances parcels that don't touch, each by itself; a ``plant.solver_api.Solver`` for any law.

    Args:
        scene: the scene's physics.
        spec: length of a step, or tolerance.
        array: the surface.
        rate: of the motors, 1/s; 0 without.
    """

    state_fields: ClassVar[StateFields] = StateFields(
        shared=(
            "_paces",
            "_rollers.passed",
            "_stiction.grips",
            "_stiction.counts",
            "_stiction.begun",
            "_stiction.found",
            "_stiction.limits",
            "_stiction.caught",
            "_springs.moments",
            "_edges.share",
            "_transfer.shift",
            "_transfer.memory",
        )
    )

    def __init__(self, scene: PlantSpec, spec: ImplicitSpec, array: CellArray, rate: float) -> None:
        from plant.kernels.implicit import (
            entry as implicit_entry,  # compiles or loads: only where a plant is really built
        )

        super().__init__(array, scene.parcels, rate)
        self._entry: Any = implicit_entry
        traction = scene.friction.traction()
        masses = [parcel.mass_kg for parcel in scene.parcels]
        self._springs = make_springs(scene, array)
        self._edges = make_edges(scene, self.capacity)
        self._rollers = make_rollers(scene, array)
        self._drag = make_drag(scene)
        self._transfer = make_transfer(scene)
        self._factors = make_factors(scene, array)
        self._stiction = make_stiction(scene, self.capacity)
        self._loaded = scene.effects.wheel_load is not None
        self._handed = WheelLoadSum()
        self._laws: Floats = np.zeros((len(masses), implicit_layout.LAW_SIZE))
        self._paces: Floats = np.zeros((len(masses), implicit_layout.PACE_SIZE))
        for i, (mass_kg, parcel) in enumerate(zip(masses, self.parcels, strict=True)):
            self._laws[i] = coefficients(traction, mass_kg, scene.gravity_m_s2)
            load_wheels(scene, self._laws[i], mass_kg)
            self._paces[i] = first_pace(parcel, spec)
            if spec.step_s is None:
                locate(self._laws[i], self._paces[i], parcel, traction, mass_kg, scene, spec)

    def _make_workspace(self) -> ImplicitWorkspace:
        cells = len(self._array)
        work = make_workspace(cells, self.capacity)
        return work._replace(slowing=make_slowing(cells, self.capacity)) if self._loaded else work

    def advance(self, indices: NDArray[np.int64], leg: Segment) -> list[AdvanceResult]:
        """Move some parcels; see ``plant.solver_api.Solver``."""
        results = super().advance(indices, leg)
        self._handed.flush(leg.motion.slowing)
        return results

    def _memory(self) -> Sequence[NDArray[Any]]:
        passed = () if self._rollers is None else (self._rollers.passed,)
        grips = () if self._stiction is None else (self._stiction.grips, self._stiction.counts)
        return *super()._memory(), self._paces, *passed, *grips

    def _advance_block(
        self, workspace: ThreadWorkspace[ImplicitWorkspace], block: NDArray[np.int64], errand: AdvanceArgs
    ) -> tuple[int, int]:
        surface, span_s, times_s, out = errand
        surface = surface._replace(
            springs=self._springs,
            edges=self._edges,
            rollers=self._rollers,
            drag=self._drag,
            stiction=self._stiction,
            factors=self._factors,
            transfer=self._transfer,
        )
        laws, paces = self._laws, self._paces
        done = self._entry.advance_block(
            surface,
            self.packed,
            workspace.work,
            self._stop,
            laws,
            paces,
            block,
            span_s,
            times_s,
            out,
            workspace.log,
            workspace.report,
        )
        if workspace.work.slowing is not None:
            self._handed.add(workspace.work.slowing, int(block[0]))
        return done
