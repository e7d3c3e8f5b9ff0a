"""What boards know of motors."""

from __future__ import annotations

import pytest

from cell_firmware.build import MotorFacts, wheels_of
from deploy.scenes.errors import SceneError
from deploy.scenes.files import load_scene
from deploy.scenes.motor_facts import motor_facts
from deploy.scenes.overrides import Override
from plant.effects.motors import MotorsSpec

DC = {
    "rotor_inertia_kg_m2": 1e-6,
    "wheel_radius_m": 0.02,
    "resistance_ohm": 10.0,
    "torque_constant_n_m_per_a": 0.01,
}


def test_a_scene_without_motors_has_no_motor_facts() -> None:
    assert motor_facts(None) is None


def test_first_order_motors_give_supply_and_free_speed() -> None:
    assert motor_facts(MotorsSpec(supply_v=6.0, speed_per_volt_m_s=0.2)) == MotorFacts(6.0, 6.0 * 0.2)
    assert motor_facts(MotorsSpec()) == MotorFacts(12.0, 12.0 * 0.1)


def test_a_dc_motor_gives_its_wheel_too() -> None:
    """Without gears and damping a volt is k rad/s: 100 a volt, at 0.02 m."""
    found = motor_facts(MotorsSpec.model_validate({"supply_v": 6.0, "dc": DC}))
    assert found is not None
    assert found.free_speed_m_s == pytest.approx(6.0 * 100.0 * 0.02)
    assert found.wheel_radius_m == 0.02


def test_an_encoder_s_counts_are_of_the_motor_s_wheel() -> None:
    effects = {"motors": {"supply_v": 1.0, "dc": DC}, "encoder": {"counts_per_revolution": 100}}
    scene = load_scene("elliptic", [Override(("effects",), effects, "")])
    assert wheels_of(scene.cells, scene.effects.of_cells(), motor_facts(scene.effects.motors)) is not None
    other = {**effects, "encoder": {"counts_per_revolution": 100, "wheel_radius_m": 0.03}}
    with pytest.raises(SceneError, match=r"wheel_radius_m = 0.03: must be that of effects.motors, 0.02"):
        load_scene("elliptic", [Override(("effects",), other, "")])
