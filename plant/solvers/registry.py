"""Every solver there is: a new one is a file, its spec in ``plant.specs``, and a line here."""

from __future__ import annotations

from plant.array import CellArray
from plant.kernels.common import cache
from plant.solver_api import Solver
from plant.solver_specs import (
    ExactSpec,
    FixedStepSpec,
    HeyokaSpec,
    ImplicitSpec,
    QuasiStaticSpec,
    SciPySpec,
    SolverSpec,
)
from plant.solvers.exact import Exact
from plant.solvers.fixed_step import FixedStep
from plant.solvers.heyoka import Heyoka
from plant.solvers.implicit import Implicit
from plant.solvers.quasi_static import QuasiStatic
from plant.solvers.scipy import SciPy
from plant.specs import PlantSpec

_KERNELS = {"exact": "exact", "implicit": "implicit", "quasi_static": "quasi", "fixed_step": "fixed"}
"""Folder of each compiled solver's kernels."""


def is_compiled(spec: SolverSpec, *, divided: bool = False) -> bool:
    """Whether a solver's kernels are on disk; the first run of a version takes seconds to compile them.

    Args:
        spec: of the solver.
        divided: whether wheels change, or cells read, on the way of a call.
    """
    if spec.name not in _KERNELS:
        return True
    # numba keeps each module's kernels in a folder named after the module's own, and a hash of where that lies
    names = [f"{_KERNELS[spec.name]}_*/block.advance_block-*.nbi"]
    if divided and spec.name == "exact":
        names.append("exact_*/block.advance_segmented-*.nbi")
    return all(any(cache.folder()[0].glob(name)) for name in names)


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
