"""The rate of a residual: known decays, under noise, above floors, and against SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy import stats

from deploy.protocol_report.residuals import Rate, _slope, fit_rate

Floats = NDArray[np.float64]


ROUNDING = 4096 * 2.0**-52


def found(residual: Floats, scale: float = 1.0) -> Rate:
    rate = fit_rate(np.arange(len(residual)), residual, np.full(len(residual), scale))
    assert rate is not None
    return rate


@given(st.floats(0.5, 0.9999), st.integers(60, 3000), st.integers(1, 7))
def test_an_exponential_decay_has_its_factor_however_it_is_sampled(
    factor: float, ticks: int, every: int
) -> None:
    rate = fit_rate(np.arange(ticks) * every, factor ** (np.arange(ticks) * every), np.ones(ticks))
    if rate is None:  # it was rounding before there were ticks enough
        assert factor ** (5 * every) < ROUNDING
        return
    assert rate.factor == pytest.approx(factor, rel=1e-9)
    assert rate.low <= rate.factor <= rate.high


@given(st.floats(0.9, 0.99), st.floats(1e-9, 1e-4), st.integers(0, 50))
def test_noise_at_the_end_does_not_change_the_rate(factor: float, noise: float, seed: int) -> None:
    ticks = int(3 * np.log(noise) / np.log(factor))  # a third of them before the noise is all there is
    decay = factor ** np.arange(ticks)
    drawn = noise * np.abs(np.random.default_rng(seed).normal(1.0, 0.3, ticks))
    rate = found(np.hypot(decay, drawn))
    assert np.log(rate.factor) == pytest.approx(np.log(factor), rel=0.05)
    assert rate.floor == pytest.approx(noise, rel=0.3)
    assert rate.to_tick < 0.45 * ticks


def test_the_slowest_of_several_decays_is_what_counts() -> None:
    tick = np.arange(1500)
    rate = found(0.99**tick + 20 * 0.9**tick + 5 * 0.97**tick)
    assert rate.factor == pytest.approx(0.99, abs=1e-7)
    assert rate.floor is None


def test_below_rounding_nothing_is_fitted() -> None:
    tick = np.arange(3000)
    decay = 100 * np.hypot(0.98**tick, 3e-16 * (1 + np.sin(tick) ** 2))
    rate = found(decay, scale=100.0)
    assert rate.factor == pytest.approx(0.98, rel=1e-9)
    assert rate.to_tick == pytest.approx(np.log(ROUNDING) / np.log(0.98), abs=3)
    assert rate.floor is None
    assert found(np.where(decay > 1e-12, decay, 0.0), scale=100.0).factor == pytest.approx(0.98, rel=1e-9)


def test_what_oscillates_counts_by_its_size() -> None:
    tick = np.arange(2000)
    rate = found(np.abs(np.cos(0.3 * tick)) * 0.996**tick)
    assert np.log(rate.factor) == pytest.approx(np.log(0.996), rel=0.02)
    steady = found(1.5 + np.sin(0.11 * tick))
    assert steady.factor == pytest.approx(1.0, abs=1e-4)
    assert steady.low < 1.0 < steady.high


def test_growth_is_a_factor_above_one_and_no_floor() -> None:
    tick = np.arange(900)
    grows = 1e-12 + 1e-15 * 1.08**tick
    rate = fit_rate(tick, grows, 1.0 + grows)
    assert rate is not None
    assert rate.factor == pytest.approx(1.08, rel=1e-6)
    assert rate.decades < -2
    assert (rate.to_tick, rate.ticks_per_decade) == (899, None)


def test_a_slow_decay_that_has_hardly_begun_is_no_floor() -> None:
    assert found(0.9999 ** np.arange(400)).factor == pytest.approx(0.9999, rel=1e-9)


def test_ticks_a_decade() -> None:
    assert found(0.1 ** (np.arange(300) / 30)).ticks_per_decade == pytest.approx(30)


@pytest.mark.parametrize("residual", [[], [1.0, 0.5, 0.25], [0.0] * 50, [np.nan] * 50, [1.0] + [0.0] * 50])
def test_of_too_little_there_is_no_rate(residual: list[float]) -> None:
    assert fit_rate(np.arange(len(residual)), np.array(residual), np.ones(len(residual))) is None


@given(st.integers(6, 40), st.integers(0, 100))
def test_slope_and_interval_are_theil_and_sens(points: int, seed: int) -> None:
    draw = np.random.default_rng(seed)
    x, y = np.sort(draw.random(points)) + np.arange(points), draw.normal(size=points)
    expected = stats.theilslopes(y, x)
    slope, low, high = _slope(x, y)
    assert slope == pytest.approx(expected.slope)
    assert (low, high) == (pytest.approx(expected.low_slope), pytest.approx(expected.high_slope))
