"""Gains in integers: what they become, what they cost, and which are refused."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from cell_firmware.errors import SettingError
from cell_firmware.specs import SpeedLoopSpec
from cell_firmware.speed_loop.scaling import LARGEST_SWING, Gain, Scaling
from cell_firmware.speed_loop.sensing import Encoder, FixedPointTachometer
from tests.cell_firmware.speed_loop.wheels import PERIOD_S, SUPPLY_V, TURN_M

LARGEST = 2**31 - 1
FACTORS = st.floats(1e-4, 1e9)


@given(FACTORS)
def test_a_gain_is_a_15_bit_word_within_1_in_32768(factor: float) -> None:
    gain = Gain.nearest(factor)
    assert 0 <= gain.word < 2**15
    assert gain.factor == pytest.approx(factor, rel=2.0**-15)


@given(st.floats(1e-12, 1e-4))
def test_a_small_gain_is_within_half_a_step_at_the_finest_shift(factor: float) -> None:
    gain = Gain.nearest(factor)
    assert gain.shift <= 30
    assert abs(gain.factor - factor) <= max(2.0**-31, factor * 2.0**-15)


@given(FACTORS, st.integers(-(2**15), 2**15))
def test_a_product_is_the_exact_one_rounded_to_the_nearest_and_keeps_its_sign(
    factor: float, value: int
) -> None:
    gain = Gain.nearest(factor)
    exact = value * gain.word * Fraction(2) ** -gain.shift
    product = gain.times(value)
    assert abs(product - exact) <= Fraction(1, 2)
    assert product * value >= 0


@given(st.floats(1e-12, 1.0), st.integers(-LARGEST_SWING, LARGEST_SWING))
@example(1.0, -LARGEST_SWING)
@example(1.0 - 2.0**-15, LARGEST_SWING)
def test_a_share_is_the_exact_one_rounded_away_from_zero_and_no_more_than_all(
    factor: float, value: int
) -> None:
    gain = Gain.nearest(factor)
    exact = value * gain.word * Fraction(2) ** -gain.shift
    product = gain.away_from_zero(np.array([value], dtype=np.int32))
    assert product.dtype == np.int32
    moved = int(product[0])
    assert 0 <= abs(moved) - abs(exact) < 1
    assert abs(moved) <= abs(value)
    assert moved * value >= 0


def scaling(levels: int = 2000, counts: int = 256, **gains: float) -> Scaling:
    spec = SpeedLoopSpec.model_validate(gains)
    return Scaling(spec, PERIOD_S, SUPPLY_V, levels, Encoder(PERIOD_S, TURN_M / counts))


def test_gains_mean_in_integers_what_they_mean_in_volts() -> None:
    """By hand: 1 count a period is 0.17976 m/s, 1 level 6 mV; Q4 to Q12 is 256."""
    made = scaling()
    per_count = TURN_M / 256 / PERIOD_S
    assert made.kp.factor == pytest.approx(256 * 12.0 * per_count / 0.006, rel=2e-5)
    assert made.ki.factor == pytest.approx(256 * 200.0 * per_count * PERIOD_S / 0.006, rel=2e-5)
    kp, ki, ahead = made.realised()
    assert (kp.requested, ki.requested, ahead.requested) == (12.0, 200.0, 0.0)
    assert kp.realised == pytest.approx(12.0, rel=2.0**-15)
    assert ki.realised == pytest.approx(200.0, rel=2.0**-15)
    assert ahead.realised == 0.0
    assert kp.word * 2.0**-kp.shift == made.kp.factor


@pytest.mark.parametrize(
    ("levels", "counts", "bits"),
    [(255, 256, 20), (2000, 256, 23), (2000, 1920, 23)],
)
def test_outputs_take_as_many_bits_as_levels_and_12_more(levels: int, counts: int, bits: int) -> None:
    assert scaling(levels, counts).output_limit.bit_length() == bits


def test_the_worst_rounding_is_half_a_step_for_every_gain_that_is_shifted_right() -> None:
    made = scaling()  # kp is shifted to the left: exact
    assert (made.kp.shift <= 0, made.ki.shift > 0) == (True, True)
    assert made.rounding_v == pytest.approx(0.5 * SUPPLY_V / (2000 * 4096))
    fine = scaling(counts=1920, feed_forward_v_per_m_s=1.0)
    assert fine.rounding_v == pytest.approx(1.5 * SUPPLY_V / (2000 * 4096))


@pytest.mark.parametrize(
    ("gains", "field", "why"),
    [
        ({"kp_v_per_m_s": 1e6}, "kp_v_per_m_s", "32"),
        ({"kp_v_per_m_s": 1e300}, "kp_v_per_m_s", "least error"),
        ({"kp_v_per_m_s": 1e-3, "ki_v_per_m": 1e6}, "ki_v_per_m", "32"),
        ({"feed_forward_v_per_m_s": 1e4}, "feed_forward_v_per_m_s", "32"),
        ({"kp_v_per_m_s": 1e-9}, "kp_v_per_m_s", "so small that it rounds to nothing"),
        ({"ki_v_per_m": 1e-7}, "ki_v_per_m", "so small that it rounds to nothing"),
        ({"feed_forward_v_per_m_s": 1e-9}, "feed_forward_v_per_m_s", "so small that it rounds to nothing"),
    ],
)
def test_a_gain_that_does_not_fit_is_refused_by_name(gains: dict[str, float], field: str, why: str) -> None:
    with pytest.raises(SettingError) as caught:
        scaling(**gains)
    assert caught.value.path == ("cells", "speed_loop", field)
    assert caught.value.value == gains[field]
    assert why in caught.value.rule


def test_without_a_gain_there_is_nothing_to_refuse() -> None:
    made = scaling(kp_v_per_m_s=0.0, ki_v_per_m=0.0)
    assert (made.kp.times(1000), made.ki.times(1000), made.rounding_v) == (0, 0, 0.0)
    assert made.share.factor == 0.0


def test_the_share_is_that_of_the_integral_in_what_an_error_comes_to() -> None:
    gains = {"kp_v_per_m_s": 12.0, "ki_v_per_m": 200.0}
    assert scaling(**gains).share.factor == pytest.approx(0.8192 / 12.8192, rel=1e-4)
    assert scaling(**gains, feed_forward_v_per_m_s=9.0).share.factor == pytest.approx(
        0.8192 / 21.8192, rel=1e-4
    )
    assert scaling(kp_v_per_m_s=0.0).share.factor == 1.0
    assert scaling(ki_v_per_m=0.0).share.factor == 0.0


@given(
    st.floats(0.0, 1e4),
    st.floats(0.0, 1e6),
    st.floats(0.0, 1e3),
    st.integers(1, 65_535),
    st.sampled_from([0, 16, 256, 1920]),
)
def test_no_sum_of_a_loop_that_is_not_refused_exceeds_32_bits(
    kp: float, ki: float, ahead: float, levels: int, counts: int
) -> None:
    spec = SpeedLoopSpec(kp_v_per_m_s=kp, ki_v_per_m=ki, feed_forward_v_per_m_s=ahead)
    tachometer = Encoder(PERIOD_S, TURN_M / counts) if counts else FixedPointTachometer(PERIOD_S, 1e-3)
    try:
        made = Scaling(spec, PERIOD_S, SUPPLY_V, levels, tachometer)
    except SettingError:
        return
    error, reference = made.error_limit, made.reference_limit
    products = [abs(gain.word) * error for gain in (made.kp, made.ki)] + [made.feed_forward.word * reference]
    assert max(products) + 2**29 <= LARGEST  # before the shift, with what rounds it
    assert (
        sum((made.kp.times(error), made.ki.times(error), made.feed_forward.times(reference)))
        + made.output_limit
        <= LARGEST
    )
    assert 2 * made.output_limit <= LARGEST_SWING
    assert 0.0 <= made.share.factor <= 1.0
