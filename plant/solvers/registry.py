"""Every solver there is: a new one is a file, its spec in ``plant.specs``, and a line here."""

from __future__ import annotations

from plant.array import CellArray
from plant.friction.viscous import Viscous
from plant.solvers.exact import Exact
from plant.solvers.solver import Solver
from plant.specs import ExactSpec, PlantSpec


def make_solver(spec: PlantSpec, array: CellArray, rate: float) -> Solver:
    """The solver that a scene asks for, its parcels at their start.

    Args:
        spec: the scene's physics.
        array: the surface.
        rate: of the motors, 1/s; 0 without.
    """
    assert isinstance(spec.solver, ExactSpec)
    assert isinstance(spec.friction, Viscous), "this is a bug: the spec refuses what exact does not solve"
    return Exact(array, spec.parcels, spec.friction.rate(spec.gravity_m_s2), rate, spec.solver)
