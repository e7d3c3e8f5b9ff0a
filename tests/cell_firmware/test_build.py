"""A scene's cells get the parts that it asks for, and settings that don't go together are refused by name."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import pytest

from bus.lattice import Lattice
from cell_firmware.build import MotorFacts, build_controller, wheels_of
from cell_firmware.components import LinkDriver, WheelDriver
from cell_firmware.controller import ControllerWrapper
from cell_firmware.effects.registry import CellEffects
from cell_firmware.effects.serial.lines import SerialLines
from cell_firmware.effects.serial.message_level import MessageLevelLines
from cell_firmware.errors import SettingError
from cell_firmware.protocols.presence_field import PresenceField, PresenceFieldParameters
from cell_firmware.specs import CellsSpec
from cell_firmware.speed_loop import SpeedLoop
from cell_firmware.speed_loop.fixed_point import FixedPointLoop

MOTORS = MotorFacts(12.0, 1.2)


def wheels(
    motors: MotorFacts | None = MOTORS, cells: CellsSpec | None = None, **effects: Any
) -> WheelDriver | None:
    return wheels_of(cells or CellsSpec(), CellEffects.model_validate(effects), motors)


def test_wheels_without_motors_have_no_loop() -> None:
    assert wheels(None) is None


def test_the_arithmetic_is_the_requested_one() -> None:
    assert isinstance(wheels(), SpeedLoop)
    assert isinstance(wheels(encoder={}, pwm={}), SpeedLoop)
    assert isinstance(wheels(fixed_point={}), FixedPointLoop)


def test_what_a_scene_does_not_ask_for_is_not_imported() -> None:
    code = """
import json, sys
from cell_firmware.build import MotorFacts, wheels_of
from cell_firmware.effects.registry import CellEffects
from cell_firmware.specs import CellsSpec
wheels_of(CellsSpec(), CellEffects(), MotorFacts(12.0, 1.2))
print(json.dumps([name for name in sys.modules if name.startswith("cell_firmware.speed_loop.")]))
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert "cell_firmware.speed_loop.floating" in json.loads(done.stdout)
    assert "cell_firmware.speed_loop.fixed_point" not in json.loads(done.stdout)
    assert "cell_firmware.speed_loop.scaling" not in json.loads(done.stdout)


@pytest.mark.parametrize(
    ("motors", "effects", "path", "rule"),
    [
        (
            MotorFacts(12.0, 1.2, 0.05),
            {"encoder": {"wheel_radius_m": 0.03}},
            "encoder.wheel_radius_m",
            "must be that of effects.motors, 0.05, or be left out",
        ),
        (
            MOTORS,
            {"encoder": {"counts_per_revolution": 8000}},
            "encoder.counts_per_revolution",
            "at most 127 counts a period can be distinguished, and a wheel without load makes 208.6 at supply_v",
        ),
        (
            MOTORS,
            {"encoder": {}, "fixed_point": {"speed_unit_m_s": 0.001}},
            "fixed_point.speed_unit_m_s",
            "the unit of speeds is a count a period where there is effects.encoder: leave it out",
        ),
        (
            MotorFacts(12.0, 2.4),
            {"fixed_point": {}},
            "fixed_point.speed_unit_m_s",
            "a 16-bit word represents speeds up to 2.048 m/s, and a wheel without load has 2.4 at supply_v",
        ),
    ],
)
def test_settings_that_do_not_go_together_are_refused(
    motors: MotorFacts, effects: dict[str, Any], path: str, rule: str
) -> None:
    with pytest.raises(SettingError) as caught:
        wheels(motors, **effects)
    assert ".".join(str(key) for key in caught.value.path) == f"effects.{path}"
    assert caught.value.rule == rule


def test_the_fastest_wheel_that_can_be_counted_is_not_refused() -> None:
    assert wheels(MotorFacts(12.0, 126.9 * 0.03 * 6.2831853 / 256 / 0.004096), encoder={}) is not None
    with pytest.raises(SettingError, match="at most 127 counts"):
        wheels(MotorFacts(12.0, 127.1 * 0.03 * 6.2831853 / 256 / 0.004096), encoder={})


def test_a_clock_that_is_slow_counts_more_in_a_period() -> None:
    nearly = MotorFacts(12.0, 126.0 * 0.03 * 6.2831853 / 256 / 0.004096)
    assert wheels(nearly, encoder={}, clock={"error_ppm": 7_000.0}) is not None
    for clock in ({"error_ppm": 8_500.0}, {"cells": [{"cell": [0, 0], "error_ppm": 8_500.0}]}):
        with pytest.raises(SettingError, match=r"a wheel without load makes 127\.1"):
            wheels(nearly, encoder={}, clock=clock)


def test_gains_that_do_not_fit_are_refused_where_they_are_integers_only() -> None:
    cells = CellsSpec.model_validate({"speed_loop": {"kp_v_per_m_s": 1e9}})
    assert wheels(cells=cells) is not None
    with pytest.raises(SettingError) as caught:
        wheels(cells=cells, fixed_point={})
    assert str(caught.value).startswith(
        "cells.speed_loop.kp_v_per_m_s = 1000000000.0: fixed point: too large"
    )


SERIAL: dict[str, Any] = {"serial": {}}


@pytest.mark.parametrize(
    ("effects", "kind"),
    [
        (SERIAL, MessageLevelLines),
        ({**SERIAL, "clock": {"error_ppm": 50.0}}, MessageLevelLines),
        ({**SERIAL, "cop": {"timeout_s": 0.016384, "reboot_s": 0.01}}, MessageLevelLines),
        ({**SERIAL, "cop": {"timeout_s": 0.016384, "reboot_s": 0.005}}, SerialLines),
        ({**SERIAL, "clock": {"error_ppm": 30_000.0}}, SerialLines),
        ({**SERIAL, "link_loss": {"probability": 0.1}}, SerialLines),
        ({**SERIAL, "link_delay": {"ticks": 1}}, SerialLines),
        ({"serial": {"sharing": "mux"}}, SerialLines),
        ({"serial": {"ring_bytes": 0}}, SerialLines),
    ],
)
def test_lines_go_byte_by_byte_exactly_where_something_can_happen_to_a_byte(
    effects: dict[str, Any], kind: type[LinkDriver]
) -> None:
    enabled, spec = CellEffects.model_validate(effects), CellsSpec(firmware="presence_field")
    lattice = Lattice((0, column) for column in range(200))
    clocks = None if enabled.clock is None else enabled.clock.clocks(lattice, spec.period_ns, 1)
    field = {"kind": "uniform", "velocity_m_s": [0.1, 0.0]}
    firmware = PresenceField(PresenceFieldParameters.model_validate({"field": field}))
    found: Any = build_controller(firmware, spec, enabled, None, clocks)
    while isinstance(found, ControllerWrapper):
        found = found.controller
    assert type(found.links) is kind
