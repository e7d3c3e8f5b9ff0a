"""Coulomb's law against a solution that steps in no way like the plant: event-driven, by Filippov's rule."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from plant.plant import Plant
from tests.plant.filippov import Filippov, LiftedError
from tests.plant.laws import COULOMB, MU
from tests.plant.scenes import SECOND, Floats, G, bench, parcel, solved

SPAN_S = 0.5
RADIUS_M = 0.36
"""Of the parcels here, at most."""
SEEDS = range(60)
"""Scenes tried; those in which a support is lifted are beyond the reference."""


def _scene(seed: int, solver: dict[str, Any]) -> tuple[Plant, Floats]:
    """A parcel on nine cells, sliding and turning, and random speeds of their wheels."""
    draw = np.random.default_rng([seed, 7])
    body = parcel(
        size_m=tuple(draw.uniform(0.36, 0.5, 2)),
        position_m=tuple(draw.uniform(-0.03, 0.03, 2)),
        angle_rad=draw.uniform(0.0, 6.0),
        velocity_m_s=tuple(draw.uniform(-0.3, 0.3, 2)),
        angular_velocity_rad_s=draw.uniform(-4.0, 4.0),
    )
    plant = solved(solver, body, law=COULOMB, rows=3, columns=3, pitch_m=0.16)
    return plant, draw.uniform(-0.3, 0.3, (9, 2))


def _reference(seed: int) -> tuple[Filippov, Floats]:
    plant, drives = _scene(seed, {"name": "implicit"})
    reference = Filippov(bench(plant, drives, mu=MU))
    return reference, reference.run(plant.state[0], SPAN_S)


def _off_m(seed: int, solver: dict[str, Any], known: Floats) -> float:
    """How far from the reference a solver ends at the footprint, m."""
    plant, drives = _scene(seed, solver)
    plant.advance(drives, round(SPAN_S * SECOND))
    off = np.abs(plant.state[0] - known)
    return float(np.hypot(off[0], off[1]) + RADIUS_M * off[2])


def _controlled(tolerance: float) -> dict[str, Any]:
    return {"name": "implicit", "tolerance": tolerance, "capture_m": 0.1 * tolerance}


def test_the_reference_has_a_block_reach_its_wheels_when_it_should_and_stick() -> None:
    """At V / (mu g), by both axes alike; the rest of the way at the wheels' speed."""
    body = parcel(size_m=(0.5, 0.5), position_m=(0.0, 0.0), angle_rad=0.0)
    plant = solved({"name": "implicit"}, body, law=COULOMB, rows=3, columns=3, pitch_m=0.16)
    reference = Filippov(bench(plant, np.full((9, 2), [0.2, 0.1]), mu=MU))
    ended = reference.run(plant.state[0], 0.1)
    (first, *_), (last, *_) = reference.events[0], reference.events[-1]
    assert (first, last) == pytest.approx((0.1 / (MU * G), 0.2 / (MU * G)), abs=1e-13)
    assert reference.modes[-1] == (18, 0)
    assert ended[3:] == pytest.approx([0.2, 0.1, 0.0], abs=1e-13)
    assert ended[:2] == pytest.approx([0.2 * (0.1 - 0.5 * last), 0.1 * (0.1 - 0.5 * first)], abs=1e-13)


@pytest.mark.parametrize("seed", [0, 1])
def test_coulomb_keeps_its_tolerance_against_the_reference(seed: int) -> None:
    reference, known = _reference(seed)
    assert len(reference.events) >= 3
    for tolerance in (1e-4, 1e-6):
        assert _off_m(seed, _controlled(tolerance), known) <= tolerance


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_coulomb_keeps_ten_tolerances_against_the_reference_in_every_scene() -> None:
    kinds: list[str] = []
    scenes = 0
    off: list[float] = []
    for seed in SEEDS:
        try:
            reference, known = _reference(seed)
        except LiftedError:
            continue
        scenes += 1
        kinds += [kind for _, kind, _ in reference.events]
        for tolerance in (1e-4, 1e-5, 1e-6, 1e-7, 1e-8):
            off.append(_off_m(seed, _controlled(tolerance), known) / tolerance)
            assert off[-1] <= 10.0, (seed, tolerance)
    assert scenes >= 50
    assert np.mean(np.array(off) <= 1.0) >= 0.95
    assert {kind: kinds.count(kind) >= 10 for kind in ("slip ends", "stick ends", "edge")} == {
        "slip ends": True,
        "stick ends": True,
        "edge": True,
    }


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_time_stepping_tends_to_the_reference_at_first_order_over_ten_halvings() -> None:
    """Steps of one length are Moreau's: velocity and impulses of the end of a step, supports of its begin."""
    steps = [2e-2 * 0.5**k for k in range(11)]
    slopes: list[float] = []
    for seed in SEEDS[:24]:
        _, known = _reference(seed)
        off = [_off_m(seed, {"name": "implicit", "step_s": step}, known) for step in steps]
        slopes.append(float(np.polyfit(np.log(steps), np.log(off), 1)[0]))
        assert off[-1] < 3e-3 * off[0], seed
    assert min(slopes) > 0.9
    assert max(slopes) < 1.2
    assert np.median(slopes) == pytest.approx(1.0, abs=0.03)
