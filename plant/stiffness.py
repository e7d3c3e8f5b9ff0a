"""Stiffness of a parcel's motion: how fast its parts settle, and which solver follows them, in words."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from plant.friction.law import Traction
from plant.parcel_spec import ParcelSpec
from plant.solver_specs import ImplicitSpec, QuasiStaticSpec, SciPySpec
from plant.specs import PlantSpec, disagreements
from plant.wheels import Floats

STIFF_STEPS = 10.0
"""A motion that may take more steps than this in its shortest time constant is not stiff: something else takes them."""


class TimeConstant(NamedTuple):
    """How fast a part of the motion settles.

    Attributes:
        time_s: in which what is left falls to 1/e.
        part: the part.
    """

    time_s: float
    part: str


def fastest(spec: PlantSpec, parcel: ParcelSpec, levers_m: Floats) -> TimeConstant:
    """The shortest time constant of a parcel on some cells, its load shared evenly between them.

    Args:
        spec: the scene's physics.
        parcel: which.
        levers_m: ``(k, 2)`` the cells under it, from its centre of mass.
    """
    each = _damping(spec.friction.traction(), parcel.mass_kg * spec.gravity_m_s2, len(levers_m))
    turning = each * float(np.sum(levers_m * levers_m))
    rates = {
        "its translation": len(levers_m) * each / parcel.mass_kg,
        "its rotation": turning / parcel.moment_of_inertia_kg_m2(),
    }
    if spec.effects.motors is not None:
        rates["the motors' speed"] = 1.0 / spec.effects.motors.first_order.time_constant_s
    part = max(rates, key=lambda name: rates[name])
    return TimeConstant(1.0 / rates[part] if rates[part] > 0.0 else np.inf, part)


def _damping(traction: Traction, weight_n: float, cells: int) -> float:
    """Force of one cell's wheels by slip, N s/m, each carrying as much."""
    return traction.stiffness + traction.stiffness_per_load * weight_n / max(cells, 1)


def beyond_steps(spec: PlantSpec, number: int, levers_m: Floats) -> str:
    """Why a parcel's motion was given up for its steps, and what to do.

    Args:
        spec: the scene's physics, with parcels that are fed.
        number: of the parcel.
        levers_m: see `fastest`.
    """
    how = spec.solver
    if isinstance(how, SciPySpec):
        limit, key, what = how.max_evaluations_per_s, "max_evaluations_per_s", "right-hand sides"
    else:
        limit, key, what = getattr(how, "max_steps_per_s", 0.0), "max_steps_per_s", "steps"
    cause = f"more than {limit:,.0f} {what} in a simulated second (solver.{key})"
    if isinstance(how, ImplicitSpec | QuasiStaticSpec):
        return f"{cause}: take a larger solver.tolerance than {how.tolerance:g}, or steps of one length (solver.step_s)"
    constant = fastest(spec, spec.parcels[number], levers_m)
    if constant.time_s * limit > STIFF_STEPS:
        return f"{cause}: the motion is not stiff ({constant.part} settles in {constant.time_s:.2g} s); raise the limit"
    return (
        f"{cause}: the motion is stiff, {constant.part} settles in {constant.time_s:.2g} s; {_instead(spec)}"
    )


def _instead(spec: PlantSpec) -> str:
    """Name the alternative solvers that support the scene and that stiff motion doesn't slow."""
    others = (ImplicitSpec(name="implicit"), QuasiStaticSpec(name="quasi_static"))
    able = [how.name for how in others if not list(disagreements(spec.friction, spec.effects, how))]
    words = {
        "implicit": 'take solver.name = "implicit"',
        "quasi_static": '"quasi_static", which leaves inertia out',
    }
    return ", or ".join(words[name] for name in able) or "raise the limit"
