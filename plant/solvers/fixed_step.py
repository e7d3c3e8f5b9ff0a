"""The ``fixed_step`` solver: the papers' own loop, explicit steps of one length, for any law.

What a simulator does that knows nothing of events: forces from the supports of the moment, a step, and a look at what
is under the parcel then. It is here to compare with. See ``plant/kernels/fixed_advance``.
"""

from __future__ import annotations

from typing import NamedTuple, final

import numpy as np

from plant.array import CellArray
from plant.solver_specs import FixedStepSpec
from plant.solvers.implicit import ImplicitWorkspace, make_workspace
from plant.solvers.stepped import SteppedSolver
from plant.specs import PlantSpec
from plant.wheels import Floats

TABLEAUS = {
    "euler": ((0.0,), (1.0,)),
    "rk4": ((0.0, 0.5, 0.5, 1.0), (1.0 / 6.0, 1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0)),
}
"""Nodes and weights of the methods; every stage starts from the slope of the one before."""


class Scheme(NamedTuple):
    """An explicit Runge-Kutta method as the kernel reads it, and room for its slopes ``(stages, 6)``."""

    nodes: Floats
    weights: Floats
    slopes: Floats


class FixedStepWorkspace(NamedTuple):
    """Scratch of the kernels, one set a thread: that for loads and pulls, and that for a step."""

    pulls: ImplicitWorkspace
    scheme: Scheme


@final
class FixedStep(SteppedSolver[FixedStepWorkspace]):
    """Advances parcels that don't touch, each by itself; a ``plant.solver_api.Solver`` for any law.

    A set-valued law is taken for the function that is 0 at no slip.

    Args:
        scene: the scene's physics.
        spec: method, and length of a step.
        array: the surface.
        rate: of the motors, 1/s; 0 without.
    """

    def __init__(self, scene: PlantSpec, spec: FixedStepSpec, array: CellArray, rate: float) -> None:
        from plant.kernels.fixed import (
            entry as fixed_entry,  # compiles or loads: only where a plant is really built
        )

        super().__init__(scene, array, rate, fixed_entry, step_s=spec.step_s)
        self._tableau = TABLEAUS[spec.method]

    def _make_workspace(self) -> FixedStepWorkspace:
        nodes, weights = self._tableau
        scheme = Scheme(np.array(nodes), np.array(weights), np.zeros((len(nodes), 6)))
        return FixedStepWorkspace(make_workspace(len(self._array), self.capacity), scheme)
