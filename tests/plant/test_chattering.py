"""Chatter that is captured where forces have no series: the end is that of the motion with every crossing located."""

from __future__ import annotations

from typing import Any

import pytest

from plant.friction.coulomb import Coulomb
from plant.friction.registry import FrictionSpec
from tests.plant.chattering import make_chattering
from tests.plant.laws import MU, ROLLING, STICK_SLIP, VISCOUS
from tests.plant.scenes import SECOND
from tests.plant.slipping import LOADED, controlled, distance_m_of

TALL = {"load_transfer": {"centre_of_mass_height_m": 0.03}}
CONE = Coulomb(law="coulomb", coefficient=MU, viscous_n_s_per_m=10.0, contact="isotropic")
CASES: dict[str, tuple[FrictionSpec, dict[str, Any], float]] = {
    "uneven_supports": (
        STICK_SLIP,
        {"uneven_supports": {"stiffness_n_per_m": 2e4, "stiffness_spread": 0.2}},
        1.0,
    ),
    "uneven_friction": (STICK_SLIP, {"uneven_friction": {"cell_spread": 0.2, "wheel_spread": 0.1}}, 1.0),
    "roller_drag": (STICK_SLIP, {"roller_drag": {"drag_s_per_m": 0.1}}, 1.0),
    "wheel_load": (VISCOUS, LOADED, 20.0),
    "wheel_load, isotropic": (CONE, LOADED, 20.0),
    "load_transfer": (VISCOUS, TALL, 1.0),
    "load_transfer, rolling": (ROLLING, TALL, 1.0),
    "load_transfer, stick_slip": (STICK_SLIP, TALL, 1.0),
}


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("case", list(CASES))
def test_chatter_is_captured_where_wheels_differ_from_those_of_exact(case: str) -> None:
    """By steps that overlook the edge such scenes are wrong by up to ten tolerances, with hundreds of changes."""
    law, effects, volts = CASES[case]
    for seed in range(2):
        plant, drives = make_chattering(seed, controlled(1e-8), law, effects, volts=volts, off_m=1e-12)
        _, events = plant.advance(drives, SECOND // 20)
        assert "captured" in [event.kind for event in events], seed
        assert plant.support_changes < 10, seed
        located = {"name": "implicit", "tolerance": 1e-9, "capture_m": 1e-14}
        beside, _ = make_chattering(seed, located, law, effects, volts=volts, off_m=1e-12)
        beside.advance(drives, SECOND // 20)
        assert beside.support_changes > 20, seed
        assert distance_m_of(plant.state[0], beside.state[0]) < 3e-9, seed
