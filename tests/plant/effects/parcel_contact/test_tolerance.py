"""Contact found by replay: ``implicit`` ends within its tolerance of ``exact``, restarted at the instants found."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from plant.plant import Plant
from tests.plant.scenes import SECOND, Floats, parcel, solved

SPAN_S = 0.25
SCENES = 20
RADIUS_M = 0.18
"""Of the parcels here, at most."""
SENSITIVE = 10.0


def make_meeting(seed: int, solver: dict[str, Any], moved_m: float = 0.0) -> tuple[Plant, Floats]:
    """Two parcels that meet while they turn, on wheels at random speeds; the first begins ``moved_m`` to the right."""
    draw = np.random.default_rng([seed, 73])
    bodies = [
        parcel(
            size_m=tuple(draw.uniform(0.18, 0.26, 2)),
            position_m=(
                side * draw.uniform(0.19, 0.22) + (moved_m if side < 0 else 0.0),
                draw.uniform(-0.06, 0.06),
            ),
            angle_rad=draw.uniform(0.0, 6.0),
            velocity_m_s=(-side * draw.uniform(0.4, 0.8), draw.uniform(-0.1, 0.1)),
            angular_velocity_rad_s=draw.uniform(-3.0, 3.0),
        )
        for side in (-1, 1)
    ]
    rules = {
        "parcel_contact": {
            "restitution": float(draw.uniform(0.0, 0.8)),
            "friction": float(draw.uniform(0.0, 0.4)),
        }
    }
    plant = solved(solver, *bodies, effects=rules, rows=30, columns=30, pitch_m=0.05)
    return plant, draw.uniform(-0.3, 0.3, (len(plant.array), 2))


def end_of(make: Callable[[], tuple[Plant, Floats]]) -> tuple[Floats, int]:
    """Where both parcels end, and how often they touched."""
    plant, drives = make()
    _, events = plant.advance(drives, round(SPAN_S * SECOND))
    return plant.state.copy(), sum(event.kind == "contact" for event in events)


def distance_m(state: Floats, known: Floats) -> float:
    """How far the farther of two parcels is from a known state at the footprint, m."""
    off = np.abs(state - known)
    return float(np.max(np.hypot(off[:, 0], off[:, 1]) + RADIUS_M * off[:, 2]))


@pytest.mark.slow
@pytest.mark.parametrize("tolerance", [1e-6, 1e-8])
def test_parcels_that_meet_end_within_the_tolerance_of_exact(tolerance: float) -> None:
    def settings(name: str, tolerance: float) -> dict[str, Any]:
        return {"name": name, "tolerance": tolerance, "capture_m": 0.1 * tolerance}

    fine = settings("exact", max(1e-3 * tolerance, 1e-12))
    off: list[float] = []
    met = 0
    for seed in range(SCENES):
        known, contacts = end_of(lambda: make_meeting(seed, fine))  # noqa: B023
        beside, _ = end_of(lambda: make_meeting(seed, fine, tolerance))  # noqa: B023
        state, _ = end_of(lambda: make_meeting(seed, settings("implicit", tolerance)))  # noqa: B023
        met += contacts > 0
        if distance_m(beside, known) <= SENSITIVE * tolerance:
            off.append(distance_m(state, known) / tolerance)
    assert met >= 0.9 * SCENES
    assert len(off) >= 0.8 * SCENES
    assert max(off) <= 0.1
