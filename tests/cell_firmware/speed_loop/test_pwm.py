"""Voltages in whole timer counts."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cell_firmware.errors import FirmwareError
from cell_firmware.firmware import State
from cell_firmware.specs import SpeedLoopSpec
from cell_firmware.speed_loop.fixed_point import whole_levels
from cell_firmware.speed_loop.output import Pwm
from tests.cell_firmware.speed_loop.wheels import SUPPLY_V, cells, drive


def test_a_duty_is_a_sign_and_a_whole_magnitude() -> None:
    pwm = Pwm(10, SUPPLY_V)
    volts = np.array([[0.0, -0.0], [0.59, -0.59], [0.61, -0.61], [7.3, -7.3], [12.0, -12.0]])
    assert pwm.duty(volts).tolist() == [[0, 0], [0, 0], [1, -1], [6, -6], [10, -10]]


def test_all_of_a_period_is_the_supply() -> None:
    assert Pwm(2000, SUPPLY_V).volts(np.array([[2000, -2000]], dtype=np.int32)).tolist() == [[12.0, -12.0]]


@given(st.floats(-1.0, 1.0), st.integers(1, 65_535), st.floats(0.1, 1000.0))
def test_the_output_is_within_half_a_level_of_the_request(share: float, levels: int, supply: float) -> None:
    pwm, volts = Pwm(levels, supply), np.array([[share * supply]])
    acting = float(pwm.volts(pwm.duty(volts))[0, 0])
    assert abs(acting - volts[0, 0]) <= supply / levels * (0.5 + 1e-9)
    assert acting * share >= 0.0


@given(st.integers(-(2**28), 2**28))
def test_integers_are_rounded_to_levels_as_voltages_are(output: int) -> None:
    magnitude = (Fraction(abs(output), 4096) + Fraction(1, 2)) // 1
    assert whole_levels(np.array([output], dtype=np.int32)).tolist() == [
        magnitude if output >= 0 else -magnitude
    ]


@pytest.mark.parametrize("effects", [{"pwm": {}}, {"pwm": {}, "encoder": {}}, {"pwm": {}, "fixed_point": {}}])
def test_the_duty_is_a_register_and_what_acts(effects: dict[str, dict[str, object]]) -> None:
    part = drive(**effects)
    state: State = part.init(cells(1))
    for _ in range(3):
        state, volts = part.step(state, np.array([[0.3, -0.2]]), np.zeros((1, 2)))
        duty = part.registers(state)["duty"]
        assert np.issubdtype(duty.dtype, np.integer)
        np.testing.assert_array_equal(volts, duty * SUPPLY_V / 2000)
    assert duty[0, 0] > 600 > 0 > duty[0, 1]


def test_a_reference_below_half_a_level_moves_nothing_until_the_integral_does() -> None:
    part = drive(SpeedLoopSpec(kp_v_per_m_s=1.0, ki_v_per_m=1.0), pwm={"levels": 10})
    state = part.init(cells(1))
    acting: list[float] = []
    for _ in range(400):
        state, volts = part.step(state, np.full((1, 2), 0.3), np.zeros((1, 2)))
        acting.append(float(volts[0, 0]))
    assert acting[0] == 0.0
    assert sorted(set(acting)) == [0.0, 1.2]


@pytest.mark.parametrize("levels", [0, 65_536])
def test_levels_that_no_timer_has_are_refused(levels: int) -> None:
    with pytest.raises(FirmwareError, match="levels must be 1 to 65535"):
        Pwm(levels, SUPPLY_V)
