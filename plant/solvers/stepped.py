"""Base class of solvers with step-by-step kernels for any traction law."""

from __future__ import annotations

from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant.array import CellArray
from plant.kernels.common import implicit_layout, layout
from plant.solvers.compiled import AdvanceArgs, ThreadedSolver, ThreadWorkspace
from plant.solvers.implicit import FIRST_STEP_S, UNBOUNDED, coefficients
from plant.solvers.springs import make_drag, make_edges, make_factors, make_springs, make_transfer
from plant.specs import PlantSpec
from plant.wheels import Floats

Workspace = TypeVar("Workspace")


class SteppedSolver(ThreadedSolver[Workspace]):
    """A ``plant.solver_api.Solver`` but for its kernel and its threads' scratch.

    Args:
        scene: the scene's physics.
        array: the surface.
        rate: of the motors, 1/s; 0 without.
        entry: the kernel's module; ``entry.advance_block`` is called as ``plant.kernels.implicit.block``'s is.
        step_s: length of a step; 0 where the tolerance sets it.
        tolerance: m at the footprint; 0 where steps are of one length.
        steps_per_s: that a parcel may take in a simulated second.
    """

    state_fields: ClassVar[StateFields] = StateFields(
        shared=("_paces", "_springs.moments", "_edges.share", "_transfer.shift", "_transfer.memory")
    )

    def __init__(
        self,
        scene: PlantSpec,
        array: CellArray,
        rate: float,
        entry: Any,
        *,
        step_s: float = 0.0,
        tolerance: float = 0.0,
        steps_per_s: float = UNBOUNDED,
    ) -> None:
        super().__init__(array, scene.parcels, rate)
        self._entry: Any = entry
        self._springs = make_springs(scene, array)
        self._edges = make_edges(scene, self.capacity)
        self._drag = make_drag(scene)
        self._transfer = make_transfer(scene)
        self._factors = make_factors(scene, array)
        traction = scene.friction.traction()
        self._laws: Floats = np.zeros((len(scene.parcels), implicit_layout.LAW_SIZE))
        self._paces: Floats = np.zeros((len(scene.parcels), implicit_layout.PACE_SIZE))
        for i, spec in enumerate(scene.parcels):
            self._laws[i] = coefficients(traction, spec.mass_kg, scene.gravity_m_s2)
        self._paces[:, implicit_layout.GYRATION] = self.packed.par[:, layout.MASS_OVER_INERTIA] ** -0.5
        self._paces[:, implicit_layout.FIXED] = step_s
        self._paces[:, implicit_layout.TOLERANCE] = tolerance
        self._paces[:, implicit_layout.NEXT] = FIRST_STEP_S
        self._paces[:, [implicit_layout.STEPS_LEFT, implicit_layout.STEPS_PER_SECOND]] = steps_per_s

    def _advance_block(
        self, workspace: ThreadWorkspace[Workspace], block: NDArray[np.int64], errand: AdvanceArgs
    ) -> tuple[int, int]:
        surface, span_s, times_s, out = errand
        surface = surface._replace(
            springs=self._springs,
            edges=self._edges,
            drag=self._drag,
            factors=self._factors,
            transfer=self._transfer,
        )
        laws, paces = self._laws, self._paces
        return self._entry.advance_block(
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
