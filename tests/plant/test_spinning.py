"""The implicit solver's tolerance where parcels spin: random scenes against the exact solver."""

from __future__ import annotations

import numpy as np
import pytest

from tests.plant.spinning import LAWS, SCENES, TOLERANCES, Outcome, measure, scene

TURN = len(LAWS) * len(TOLERANCES)
"""Scenes after which every law has met every tolerance once."""


def _check(outcomes: list[Outcome], sensitive: float) -> None:
    meant = [one for one in outcomes if not one.sensitive]
    assert len(outcomes) - len(meant) <= sensitive * len(outcomes)
    off = np.array([one.off for one in meant])
    worst = meant[int(np.argmax(off))]
    assert off.max() <= 10.0, worst
    assert np.mean(off <= 1.0) >= 0.95


def test_the_tolerance_is_kept_by_every_law_at_every_tolerance_where_parcels_spin() -> None:
    spins = [abs(scene(seed).body["angular_velocity_rad_s"]) for seed in range(TURN)]
    assert sum(spin > 20.0 for spin in spins) >= 5
    _check([measure(scene(seed)) for seed in range(TURN)], sensitive=0.1)


@pytest.mark.slow
def test_the_tolerance_is_kept_in_the_whole_sample_of_parcels_that_spin() -> None:
    _check([measure(scene(seed)) for seed in range(SCENES)], sensitive=0.05)


def test_the_sample_tells_a_solver_that_looks_at_supports_at_the_ends_of_its_steps() -> None:
    """The scenes are hard enough: RK4 with steps of a millisecond is thousands of tolerances off in them."""
    steps = {"name": "fixed_step", "method": "rk4", "step_s": 1e-3}
    off = [measure(scene(seed), steps).off for seed in (27, 30, 35, 39)]
    assert min(off) > 10.0
