"""Random scenes of one parcel that slips and sticks under ``coulomb`` on nine cells, and the reference's ends."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from plant.friction.registry import FrictionSpec
from plant.plant import Plant
from tests.plant.filippov import Filippov, LoadedFilippov
from tests.plant.laws import COULOMB, MU
from tests.plant.scenes import SECOND, Floats, bench, parcel, solved

SPAN_S = 0.5
RADIUS_M = 0.36
"""Of the parcels here, at most."""


def make_scene(
    seed: int,
    solver: dict[str, Any],
    law: FrictionSpec = COULOMB,
    effects: Mapping[str, object] | None = None,
) -> tuple[Plant, Floats]:
    """A parcel on nine cells, sliding and turning, and random speeds of their wheels: volts if there are motors."""
    draw = np.random.default_rng([seed, 7])
    body = parcel(
        size_m=tuple(draw.uniform(0.36, 0.5, 2)),
        position_m=tuple(draw.uniform(-0.03, 0.03, 2)),
        angle_rad=draw.uniform(0.0, 6.0),
        velocity_m_s=tuple(draw.uniform(-0.3, 0.3, 2)),
        angular_velocity_rad_s=draw.uniform(-4.0, 4.0),
    )
    plant = solved(solver, body, law=law, effects=effects, rows=3, columns=3, pitch_m=0.16)
    return plant, draw.uniform(-0.3, 0.3, (9, 2)) * (1.0 if effects is None else 20.0)


def make_wide_scene(
    seed: int,
    solver: dict[str, Any],
    law: FrictionSpec,
    spin_rad_s: float,
    *,
    motors: bool = False,
    others: Mapping[str, object] | None = None,
) -> tuple[Plant, Floats]:
    """A parcel on 196 cells, sliding and turning, and one of four kinds of field; or the voltages of slow motors.

    With the ``others`` among the effects.
    """
    draw = np.random.default_rng([seed, 11])
    body = parcel(
        size_m=tuple(draw.uniform(0.3, 0.7, 2)),
        position_m=tuple(draw.uniform(-0.1, 0.1, 2)),
        angle_rad=draw.uniform(0.0, 6.0),
        velocity_m_s=tuple(draw.uniform(-0.5, 0.5, 2)),
        angular_velocity_rad_s=draw.uniform(-spin_rad_s, spin_rad_s),
    )
    effects: dict[str, object] = dict(others or {})
    if motors:
        effects["motors"] = {"time_constant_s": 0.05, "speed_per_volt_m_s": 0.05}
    plant = solved(solver, body, law=law, effects=effects, rows=14, columns=14, pitch_m=0.12)
    place = plant.array.positions_m
    field = (
        draw.uniform(-0.4, 0.4, place.shape),
        -place * draw.uniform(0.5, 1.5),
        np.tile(draw.uniform(-0.4, 0.4, 2), (len(place), 1)),
        place @ np.array([[-0.5, 0.5], [-0.5, -0.5]]),
    )[seed % 4]
    return plant, field * (20.0 if motors else 1.0)


def solve_reference(seed: int) -> tuple[Filippov, Floats]:
    """The event-driven solution of a scene, and the parcel's state at its end.

    Raises:
        LiftedError: a support is lifted, which the reference doesn't know.
    """
    plant, drives = make_scene(seed, {"name": "implicit"})
    reference = Filippov(bench(plant, drives, mu=MU))
    return reference, reference.run(plant.state[0], SPAN_S)


LOADED = {
    "motors": {"time_constant_s": 0.05, "speed_per_volt_m_s": 0.05},
    "wheel_load": {"inertia_kg": 0.05},
}
"""Motors from rest, and wheels that feel what they pull."""
HEAVY = LOADED | {"wheel_load": {"inertia_kg": 0.3}}
"""So much inertia that motors make wheels give way that stick."""


def solve_loaded_reference(seed: int) -> tuple[LoadedFilippov, Floats]:
    """As ``solve_reference``, on wheels that feel what they pull (``HEAVY``)."""
    plant, drives = make_scene(seed, {"name": "implicit"}, effects=HEAVY)
    mass_kg = 2.0
    reference = LoadedFilippov(bench(plant, 0.05 * drives, mu=MU), rate=20.0, lightness=mass_kg / 0.3)
    return reference, reference.run(plant.state[0], SPAN_S)[:6]


def controlled(tolerance: float) -> dict[str, Any]:
    """Settings of ``implicit`` at a tolerance, chatter captured within a tenth of it."""
    return {"name": "implicit", "tolerance": tolerance, "capture_m": 0.1 * tolerance}


def distance_m_of(state: Floats, known: Floats) -> float:
    """How far a state is from a known one at the footprint, m."""
    off = np.abs(state - known)
    return float(np.hypot(off[0], off[1]) + RADIUS_M * off[2])


def distance_m(plant: Plant, known: Floats) -> float:
    """How far the parcel is from a known state at the footprint, m."""
    return distance_m_of(plant.state[0], known)


def off_m(
    seed: int,
    solver: dict[str, Any],
    known: Floats,
    law: FrictionSpec = COULOMB,
    effects: Mapping[str, object] | None = None,
) -> float:
    """How far from the reference a solver ends at the footprint, m."""
    plant, drives = make_scene(seed, solver, law, effects)
    plant.advance(drives, round(SPAN_S * SECOND))
    return distance_m(plant, known)
