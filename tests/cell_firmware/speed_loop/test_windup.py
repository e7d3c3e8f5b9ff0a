"""After saturation a loop responds as the linear loop does, and as after any other time of it.

The linear loop is the same loop in floating point without limits, from the steady state that the wheel really was in,
which is full speed, and with a step to the same reference.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cell_firmware.build import MotorFacts
from cell_firmware.components import WheelDriver
from cell_firmware.firmware import State
from cell_firmware.specs import SpeedLoopSpec
from tests.cell_firmware.speed_loop.wheels import GAIN, PERIOD_S, SUPPLY_V, Wheel, cells, drive, follow

TOP = SUPPLY_V * GAIN
AFTER = 0.5
SECOND = round(1.0 / PERIOD_S)
RUN_UP = SECOND // 2
ENDLESS = MotorFacts(1e6, 1e5)
BEFORES = (1.25, 1.3, 1.5, 2.0, 5.0)
LOOPS: Mapping[str, dict[str, Any]] = {
    "floating": {},
    "words": {"fixed_point": {}},
    "board": {"fixed_point": {}, "encoder": {"counts_per_revolution": 1920}, "pwm": {}},
}
APART = {"floating": 1e-5, "words": 1.5e-4, "board": 6e-3}
"""What a steady state that is not quite reached, steps of a speed and a quarter of a count a period come to, m/s."""


def response(part: WheelDriver, before: float, after: float) -> NDArray[np.float64]:
    """Speeds from the step on, after a second at full speed."""
    begin = RUN_UP + SECOND
    speeds, volts = follow(part, [before] * begin + [after] * 200, Wheel())
    assert abs(speeds[begin]) == pytest.approx(TOP, rel=0.01)
    if abs(before) > TOP:
        assert abs(volts[RUN_UP:begin].mean()) > 0.99 * SUPPLY_V
    return speeds[begin:]


@cache
def linear(kp: float, ki: float, ahead: float, before: float, after: float) -> NDArray[np.float64]:
    return response(drive(gains(kp, ki, ahead), ENDLESS), before, after)


def gains(kp: float, ki: float, ahead: float = 0.0) -> SpeedLoopSpec:
    return SpeedLoopSpec(kp_v_per_m_s=kp, ki_v_per_m=ki, feed_forward_v_per_m_s=ahead)


def recovery_s(speeds: NDArray[np.float64]) -> float:
    """How long until the wheel stays within 5 % of the way."""
    error = np.abs(speeds - AFTER)
    return float(np.flatnonzero(error > 0.05 * error[0])[-1] + 1) * PERIOD_S


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize(("kp", "ki"), [(12.0, 200.0), (6.0, 100.0), (12.0, 400.0)])
def test_recovery_after_a_second_of_saturation_takes_as_long_as_the_linear_loop_s(
    kp: float, ki: float, name: str
) -> None:
    expected = linear(kp, ki, 0.0, TOP, AFTER)
    for before in BEFORES:
        found = response(drive(gains(kp, ki), **LOOPS[name]), before, AFTER)
        assert recovery_s(found) == pytest.approx(recovery_s(expected), rel=0.2)
        np.testing.assert_allclose(found, expected, rtol=0, atol=APART[name])


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize(
    ("kp", "ki", "ahead", "sign", "after"),
    [
        (12.0, 200.0, 0.0, -1.0, 0.2),
        (6.0, 100.0, 0.0, 1.0, -0.5),
        (12.0, 200.0, 5.0, -1.0, -0.5),
        (6.0, 200.0, 8.0, 1.0, 0.5),
        (12.0, 400.0, 15.0, 1.0, 0.5),  # steady only with one of the other sign
    ],
)
def test_in_both_directions_and_with_feed_forward_the_response_is_the_linear_loop_s(
    kp: float, ki: float, ahead: float, sign: float, after: float, name: str
) -> None:
    expected = linear(kp, ki, ahead, sign * TOP, after)
    for before in (1.25, 2.0, 5.0):
        found = response(drive(gains(kp, ki, ahead), **LOOPS[name]), sign * before, after)
        np.testing.assert_allclose(found, expected, rtol=0, atol=APART[name])


def test_within_the_supply_it_is_the_linear_loop_to_the_bit() -> None:
    references = [0.4] * 200 + [-0.3] * 200
    speeds, volts = follow(drive(), references, Wheel())
    unlimited, _ = follow(drive(motors=ENDLESS), references, Wheel())
    assert np.abs(volts).max() < SUPPLY_V
    assert speeds.tobytes() == unlimited.tobytes()


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize("before", [1.25, 5.0])
def test_how_long_it_was_saturated_does_not_matter(name: str, before: float) -> None:
    def afterwards(seconds: int) -> NDArray[np.float64]:
        references = [before] * (seconds * SECOND) + [AFTER] * 120
        return follow(drive(**LOOPS[name]), references, Wheel())[0][-120:]

    np.testing.assert_allclose(afterwards(1), afterwards(4), rtol=0, atol=APART[name])


@pytest.mark.parametrize("name", LOOPS)
def test_a_blocked_wheel_winds_up_to_the_supply_and_no_further(name: str) -> None:
    """It is the steady state at full voltage; asked for the other way, the loop gives way at once and then turns."""
    part = drive(**LOOPS[name])
    state: State = part.init(cells(1))
    still = np.zeros((1, 2))
    for _ in range(2 * SECOND):
        state, volts = part.step(state, np.array([[0.5, -0.5]]), still)
        np.testing.assert_array_less(np.abs(supplies(part, state)), 1.0 + 1e-12)
    np.testing.assert_array_equal(volts, [[SUPPLY_V, -SUPPLY_V]])
    np.testing.assert_allclose(supplies(part, state), [[1.0, -1.0]], rtol=0, atol=1e-12)
    state, volts = part.step(state, np.array([[-0.5, 0.5]]), still)
    assert np.abs(volts).max() < SUPPLY_V / 2
    for _ in range(SECOND // 4):
        state, volts = part.step(state, np.array([[-0.5, 0.5]]), still)
    np.testing.assert_array_equal(volts, [[-SUPPLY_V, SUPPLY_V]])


def supplies(part: WheelDriver, state: State) -> NDArray[np.float64]:
    """Integrals over the supply."""
    registers = part.registers(state)
    if "integral_v" in registers:
        return registers["integral_v"] / SUPPLY_V
    return registers["integral"] / getattr(part, "scaling").output_limit  # noqa: B009
