"""The ``quasi_static`` solver: inertia neglected; at every instant the parcel has the velocity at which pulls balance.

Murphey and Burdick's reduction of distributed manipulation: the minimum of the dissipation potential, ``0 in dPhi(u)``,
with positions following. It holds where wheel speeds seen by the parcel change slowly against ``1 / (mu g)``. See
``plant/kernels/quasi/advance.py`` for the velocity and the steps.
"""

from __future__ import annotations

from typing import final

from plant.array import CellArray
from plant.solver_specs import QuasiStaticSpec
from plant.solvers.implicit import ImplicitWorkspace, make_workspace, steps_per_s
from plant.solvers.stepped import SteppedSolver
from plant.specs import PlantSpec


@final
class QuasiStatic(SteppedSolver[ImplicitWorkspace]):
    """Advances parcels that don't touch, each by itself; a ``plant.solver_api.Solver`` for laws with a balance.

    Velocities that parcels are given at the start are replaced.

    Args:
        scene: the scene's physics.
        spec: tolerance, or length of a step.
        array: the surface.
        rate: of the motors, 1/s; 0 without.
    """

    def __init__(self, scene: PlantSpec, spec: QuasiStaticSpec, array: CellArray, rate: float) -> None:
        from plant.kernels.quasi import (
            entry as quasi_entry,  # compiles or loads: only where a plant is really built
        )

        super().__init__(
            scene,
            array,
            rate,
            quasi_entry,
            step_s=spec.step_s or 0.0,
            tolerance=spec.tolerance,
            steps_per_s=steps_per_s(spec),
        )

    def _make_workspace(self) -> ImplicitWorkspace:
        return make_workspace(len(self._array), self.capacity)
