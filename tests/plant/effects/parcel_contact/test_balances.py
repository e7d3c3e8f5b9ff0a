"""Boxes thrown at each other or pressed: no momentum comes or goes, nor energy but what contacts take."""

from __future__ import annotations

import numpy as np
import pytest

from plant.effects.parcel_contact.spec import ParcelContactSpec
from plant.effects.registry import PlantEffects
from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from plant.specs import PlantSpec
from tests.plant.effects.parcel_contact.benches import BOX, Floats, box, energy, plant, still, ticks
from tests.plant.scenes import TICK_NS, G, spec

BALANCED = 1e-9
"""Of momentum, N s and N m s, and of energy, J; parcels of 2 kg have about 1 m/s."""
SEEDS = [
    0,
    1,
    *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 6)),
    *(pytest.param(seed, marks=[pytest.mark.slow, pytest.mark.nightly]) for seed in range(6, 20)),
]


def thrown(seed: int, count: int = 8) -> tuple[ParcelSpec, ...]:
    """Boxes about a middle, which they are thrown at, turning."""
    draw = np.random.default_rng([20_262, seed])
    angles = 2.0 * np.pi * (np.arange(count) + draw.uniform(0.0, 0.3, count)) / count
    return tuple(
        box(
            0.62 * float(np.cos(angle)),
            0.62 * float(np.sin(angle)),
            float(draw.uniform(0.0, np.pi)),
            velocity_m_s=(float(-speed * np.cos(angle)), float(-speed * np.sin(angle))),
            angular_velocity_rad_s=float(draw.uniform(-3.0, 3.0)),
            mass_kg=float(draw.uniform(1.0, 3.0)),
        )
        for angle, speed in zip(angles, draw.uniform(0.6, 1.2, count), strict=True)
    )


def momentum(plant: Plant, parcels: tuple[ParcelSpec, ...]) -> Floats:
    """Of all parcels: along x and y, N s, and about the origin, N m s."""
    mass = np.array([one.mass_kg for one in parcels])
    inertia = np.array([one.moment_of_inertia_kg_m2() for one in parcels])
    x, y, _, vx, vy, omega = plant.state.T
    about = np.sum(mass * (x * vy - y * vx) + inertia * omega)
    return np.array([np.sum(mass * vx), np.sum(mass * vy), about])


def worst(
    parcels: tuple[ParcelSpec, ...], restitution: float, friction: float = 0.0, step_s: float = 1e-3
) -> tuple[Floats, float, float, int]:
    """Largest errors of parcels on standing wheels: each momentum, the gain of energy in a tick, its loss in all.

    The last value is the number of contact events.
    """
    bench = plant(*parcels, restitution=restitution, friction=friction, step_s=step_s, fine=True)
    start, first, met = momentum(bench, parcels), energy(bench, parcels), 0
    off, gain, before = np.zeros(3), -np.inf, first
    for events in ticks(bench, still(bench), round(0.8e9 / TICK_NS)):
        after = energy(bench, parcels)
        off = np.maximum(off, np.abs(momentum(bench, parcels) - start))
        gain, before, met = max(gain, after - before), after, met + len(events)
    return off, gain, first - before, met


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("seed", SEEDS)
def test_boxes_thrown_together_keep_all_momentum_and_gain_no_energy(seed: int, restitution: float) -> None:
    off, gain, loss, met = worst(thrown(seed), restitution)
    assert met > 20
    assert off.max() < BALANCED
    assert gain < BALANCED
    assert loss > 1.0


@pytest.mark.parametrize("seed", SEEDS)
def test_boxes_that_bounce_fully_keep_all_momentum_and_energy(seed: int) -> None:
    off, gain, loss, met = worst(thrown(seed), 1.0)
    assert met > 20
    assert off.max() < BALANCED
    assert max(gain, abs(loss)) < BALANCED


@pytest.mark.parametrize(
    "friction", [0.3, *(pytest.param(friction, marks=pytest.mark.slow) for friction in (0.1, 1.0))]
)
def test_rough_boxes_keep_all_momentum_and_gain_no_energy(friction: float) -> None:
    off, gain, _, _ = worst(thrown(3), 0.0, friction)
    assert off.max() < BALANCED
    assert gain < BALANCED


@pytest.mark.slow
@pytest.mark.parametrize("step_s", [1e-4, 4e-3])
def test_balances_hold_in_steps_of_any_length(step_s: float) -> None:
    off, gain, _, _ = worst(thrown(0), 0.0, step_s=step_s)
    assert off.max() < BALANCED
    assert gain < BALANCED


@pytest.mark.parametrize("count", [2, 5])
def test_a_queue_that_runs_into_a_heavy_box_gives_it_all_that_it_loses(count: int) -> None:
    # a rail is the limit of such a box, and takes as much
    queue = (
        box(-0.3 - k * (BOX + 0.1), 0.05 * (-1) ** k, 0.1 * k, velocity_m_s=(0.8, 0.2)) for k in range(count)
    )
    parcels = (*queue, box(0.2, 0.1, size_m=(0.3, 1.5), mass_kg=1e6))
    off, gain, loss, met = worst(parcels, 0.0)
    assert met >= count
    assert off.max() < BALANCED
    assert gain < BALANCED
    assert loss > 0.5


@pytest.mark.parametrize("aside_m", [0.0, 0.02])
@pytest.mark.parametrize("count", [2, 6, pytest.param(20, marks=pytest.mark.slow)])
def test_a_queue_pressed_against_a_rail_moves_along_it_as_if_alone(count: int, aside_m: float) -> None:
    mu, along, seconds = 0.5, 0.2, 0.4
    parcels = tuple(box(0.5 - k * (BOX + 0.001), aside_m * (-1) ** k) for k in range(count))
    values = dict(spec(*parcels, mu=mu, rows=10, columns=120, pitch_m=0.1)) | {
        "effects": PlantEffects(parcel_contact=ParcelContactSpec(rails=(((0.626, -0.4), (0.626, 0.4)),)))
    }
    bench = Plant(PlantSpec.model_validate(values))
    for _ in ticks(bench, np.full((len(bench.array), 2), (0.3, along)), round(seconds * 1e9 / TICK_NS)):
        # belts draw all loads along the rail, to which boxes add nothing
        speed = along * (1.0 - np.exp(-mu * G * bench.time_ns * 1e-9))
        assert momentum(bench, parcels)[1] == pytest.approx(2.0 * count * speed, abs=BALANCED)
