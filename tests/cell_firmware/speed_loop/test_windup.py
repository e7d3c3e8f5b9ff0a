"""After a second of saturation a loop recovers as the linear loop does, and as after any other time of it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from cell_firmware.assembly import Motors
from cell_firmware.parts import WheelPart
from cell_firmware.specs import SpeedLoopSpec
from tests.cell_firmware.speed_loop.wheels import GAIN, PERIOD_S, SUPPLY_V, Wheel, drive, follow

TOP = SUPPLY_V * GAIN
AFTER = 0.5
SECOND = round(1.0 / PERIOD_S)
RUN_UP = SECOND // 2
ENDLESS = Motors(1e6, 1e5)
LOOPS: Mapping[str, dict[str, Any]] = {
    "floating": {},
    "words": {"fixed_point": {}},
    "board": {"fixed_point": {}, "encoder": {"counts_per_revolution": 1920}, "pwm": {}},
}


def recovery_s(part: WheelPart, before: float) -> float:
    """From a second saturated at ``before`` to ``AFTER``: how long until the wheel stays within 5 % of the way."""
    begin = RUN_UP + SECOND
    speeds, volts = follow(part, [before] * begin + [AFTER] * 500, Wheel())
    way = np.abs(speeds[begin:] - AFTER)
    assert way[0] == pytest.approx(TOP - AFTER, rel=0.01)
    if before > TOP:
        assert volts[RUN_UP:begin].mean() > 0.99 * SUPPLY_V
    return float(np.flatnonzero(way > 0.05 * way[0])[-1] + 1) * PERIOD_S


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize(
    ("kp", "ki", "before"),
    [(12.0, 200.0, 1.25), (6.0, 100.0, 1.25), (6.0, 100.0, 1.3), (12.0, 400.0, 1.25), (12.0, 400.0, 5.0)],
)
def test_recovery_after_a_second_of_saturation_takes_as_long_as_the_linear_loop_s(
    name: str, kp: float, ki: float, before: float
) -> None:
    gains = SpeedLoopSpec(kp_v_per_m_s=kp, ki_v_per_m=ki)
    linear = recovery_s(drive(gains, ENDLESS), TOP)
    assert recovery_s(drive(gains, **LOOPS[name]), before) == pytest.approx(linear, rel=0.2)


@pytest.mark.parametrize("name", LOOPS)
@pytest.mark.parametrize("before", [1.25, 5.0])
def test_how_long_it_was_saturated_does_not_matter(name: str, before: float) -> None:
    def afterwards(seconds: int) -> NDArray[np.float64]:
        references = [before] * (seconds * SECOND) + [AFTER] * 150
        return follow(drive(**LOOPS[name]), references, Wheel())[0][-150:]

    most = 6e-3 if name == "board" else 1e-4  # a quarter of a count a period
    np.testing.assert_allclose(afterwards(1), afterwards(6), rtol=0, atol=most)
