"""Every solver there is: a new one is a file, its spec in ``plant.specs``, and a line here."""

from __future__ import annotations

from plant.array import CellArray
from plant.solver_api import Solver
from plant.solver_specs import (
    ExactSpec,
    FixedStepSpec,
    HeyokaSpec,
    ImplicitSpec,
    QuasiStaticSpec,
    SciPySpec,
)
from plant.solvers.exact import Exact
from plant.solvers.fixed_step import FixedStep
from plant.solvers.heyoka import Heyoka
from plant.solvers.implicit import Implicit
from plant.solvers.quasi_static import QuasiStatic
from plant.solvers.scipy import SciPy
from plant.specs import PlantSpec


def make_solver(spec: PlantSpec, array: CellArray, rate: float) -> Solver:
    """Build the solver of a scene, with its parcels at their start.

    Args:
        spec: the scene's physics.
        array: the surface.
        rate: rate of the motors, 1/s; 0 without motors.
    """
    match spec.solver:
        case ExactSpec() as how:
            return Exact(array, spec.parcels, spec.friction.traction(), spec.gravity_m_s2, rate, how)
        case ImplicitSpec() as how:
            return Implicit(spec, how, array, rate)
        case QuasiStaticSpec() as how:
            return QuasiStatic(spec, how, array, rate)
        case FixedStepSpec() as how:
            return FixedStep(spec, how, array, rate)
        case SciPySpec() as how:
            return SciPy(spec, how, array)
        case HeyokaSpec() as how:
            return Heyoka(spec, how, array, rate)
