"""A saturated loop goes on as if it had been asked for the speed with which it would just saturate."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from cell_firmware.specs import SpeedLoopSpec
from cell_firmware.speed_loop import SpeedLoop
from cell_firmware.speed_loop.output import share
from tests.cell_firmware.speed_loop.wheels import PERIOD_S, SUPPLY_V, cells

GAIN = st.floats(0.1, 1e3)
SPEED = st.floats(-3.0, 3.0)


@given(GAIN, GAIN, st.just(0.0) | GAIN, st.floats(-SUPPLY_V, SUPPLY_V), SPEED, SPEED)
def test_the_integral_becomes_what_the_reference_that_just_saturates_makes_of_it(
    kp: float, ki: float, ahead: float, integral: float, reference: float, measured: float
) -> None:
    spec = SpeedLoopSpec(kp_v_per_m_s=kp, ki_v_per_m=ki, feed_forward_v_per_m_s=ahead)
    loop = SpeedLoop(spec, PERIOD_S, SUPPLY_V)

    def step(requested: float) -> tuple[float, float]:
        state, _ = loop.step(loop.init(cells(1)), np.zeros((1, 2)), np.zeros((1, 2)))
        state = {**state, "integral_v": np.full((1, 2), integral)}
        after, volts = loop.step(state, np.full((1, 2), requested), np.full((1, 2), measured * PERIOD_S))
        return float(after["integral_v"][0, 0]), float(volts[0, 0])

    after, volts = step(reference)
    assume(abs(volts) == SUPPLY_V)
    rest = integral - (kp + ki * PERIOD_S) * measured
    just = (volts - rest) / (kp + ki * PERIOD_S + ahead)
    assert step(just) == pytest.approx((after, volts), abs=1e-9 * (1.0 + kp + ahead + ki))


def test_the_share_is_none_without_an_integral_and_all_where_there_is_nothing_else() -> None:
    assert share(12.0, 0.0, 3.0) == 0.0
    assert share(0.0, 0.0, 0.0) == 0.0
    assert share(0.0, 0.8, 0.0) == 1.0
    assert share(2.0, 1.0, 1.0) == 0.25
