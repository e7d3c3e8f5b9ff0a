"""Boxes thrown at each other without friction: no momentum comes or goes, nor energy but what impacts take."""

from __future__ import annotations

import numpy as np
import pytest

from plant.parcel_spec import ParcelSpec
from plant.plant import Plant
from tests.plant.effects.parcel_contact.benches import Floats, box, energy, plant, still, ticks
from tests.plant.scenes import TICK_NS

BALANCED = 1e-9
"""Of momentum, N s and N m s, and of energy, J; parcels of 2 kg have about 1 m/s."""
SEEDS = [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 20))]


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


def worst(seed: int, restitution: float, step_s: float = 1e-3) -> tuple[Floats, float, float]:
    """What a throw is off by at most: each momentum, the gain of energy in a tick, the loss of energy in all."""
    parcels = thrown(seed)
    bench = plant(*parcels, restitution=restitution, step_s=step_s, fine=True)
    start, first, met = momentum(bench, parcels), energy(bench, parcels), 0
    off, gain, before = np.zeros(3), 0.0, first
    for events in ticks(bench, still(bench), round(0.8e9 / TICK_NS)):
        after = energy(bench, parcels)
        off = np.maximum(off, np.abs(momentum(bench, parcels) - start))
        gain, before, met = max(gain, after - before), after, met + len(events)
    assert met > 20
    return off, gain, first - before


@pytest.mark.parametrize("restitution", [0.0, 0.5])
@pytest.mark.parametrize("seed", SEEDS)
def test_boxes_thrown_together_keep_their_momentum_and_gain_no_energy(seed: int, restitution: float) -> None:
    off, gain, loss = worst(seed, restitution)
    assert off[:2].max() < BALANCED
    assert gain < BALANCED
    assert loss > 1.0


@pytest.mark.parametrize("seed", SEEDS)
def test_boxes_that_bounce_fully_keep_all_momentum_and_energy(seed: int) -> None:
    off, gain, loss = worst(seed, 1.0)
    assert off[:2].max() < BALANCED
    # an impact is up to a nanometre, and its impulse's arm as much, from where bodies meet
    assert off[2] < 10.0 * BALANCED
    assert max(gain, abs(loss)) < BALANCED


@pytest.mark.slow
def test_angular_momentum_of_boxes_that_stay_together_is_kept_to_first_order_of_the_step() -> None:
    coarse, fine = (worst(0, 0.0, step_s)[0][2] for step_s in (1e-3, 1e-4))
    assert coarse < 1e-3
    assert fine < 0.3 * coarse
