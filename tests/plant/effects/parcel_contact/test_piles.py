"""Random piles: parcels that belts drive together, of all shapes, under every law, never overlap and end well."""

from __future__ import annotations

import numpy as np
import pytest

from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.effects.registry import PlantEffects
from plant.friction.coulomb import Coulomb
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.solver_specs import ImplicitSpec
from plant.specs import PlantSpec
from tests.plant.effects.parcel_contact.benches import box, least_gap, ticks
from tests.plant.laws import LAWS
from tests.plant.scenes import spec

PILES = 48
NIGHTLY = 200
"""Random piles of the slow tier, and at night."""
SPREAD_M = 0.52
"""Between the centres of parcels at the start: more than their diagonals."""
DEPTH_M = 1e-9
"""Overlap that no two bodies ever exceed."""
EDGE_M = 1.35
"""Place of the rails."""


def parcels(draw: np.random.Generator, count: int) -> tuple[ParcelSpec, ...]:
    """Boxes of random sizes, angles and masses on a loose grid, in random places of it."""
    places = draw.permutation(25)[:count]
    return tuple(
        box(
            (int(place) % 5 - 2) * SPREAD_M,
            (int(place) // 5 - 2) * SPREAD_M,
            float(draw.uniform(0.0, np.pi)),
            size_m=(float(draw.uniform(0.25, 0.36)), float(draw.uniform(0.25, 0.36))),
            mass_kg=float(draw.uniform(0.5, 5.0)),
        )
        for place in places
    )


def pile(number: int) -> tuple[Plant, np.ndarray]:
    """A random pile, and the wheels' speeds: a sink, or belts into a corner."""
    draw = np.random.default_rng([20_261, number])
    friction = list(LAWS.values())[number % len(LAWS)]
    boxes = parcels(draw, int(draw.integers(2, 10)))
    rails = (((EDGE_M, -1.45), (EDGE_M, 1.45)), ((-1.45, EDGE_M), (1.45, EDGE_M)))
    rules = ParcelContactSpec(
        rails=rails if number % 4 < 2 else (),
        friction=float(draw.choice([0.0, 0.1, 0.3, 1.0])),
        restitution=float(draw.choice([0.0, 0.0, 0.5])),
    )
    values = dict(spec(*boxes, rows=30, columns=30, pitch_m=0.1)) | {
        "friction": friction,
        "effects": PlantEffects(parcel_contact=rules),
    }
    if isinstance(friction, Coulomb):
        values["solver"] = ImplicitSpec(name="implicit", tolerance=1e-6)
    plant = Plant(PlantSpec.model_validate(values))
    drives = np.full((900, 2), (1.0, 0.8)) if rules.rails else -plant.array.positions_m
    return plant, drives


def flaws(number: int, seconds: float) -> list[str]:
    """What is wrong with a pile: overlap, or an end before the time."""
    plant, drives = pile(number)
    found: list[str] = []
    for tick, _ in enumerate(ticks(plant, drives, round(seconds / 0.004_096))):
        if least_gap(plant) < -DEPTH_M:
            found.append(f"pile {number}, tick {tick}: overlap of {-least_gap(plant):.2g} m")
            break
    return found


@pytest.mark.parametrize("number", range(6))
def test_a_pile_under_each_law_never_overlaps(number: int) -> None:
    assert flaws(number, 0.6) == []


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_no_random_pile_overlaps(request: pytest.FixtureRequest) -> None:
    piles = NIGHTLY if request.config.getoption("nightly") else PILES
    assert [flaw for number in range(piles) for flaw in flaws(number, 0.6)] == []
