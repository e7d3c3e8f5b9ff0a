"""Intervals hold what they promise, for as few runs as campaigns have."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from deploy.studies.campaign.report import mean_of, share_of


def test_wilsons_interval_of_a_known_case() -> None:
    found = share_of(9, 10, 0.95)
    # by hand, z = 1.959964: (0.9 + z²/20 ± z sqrt(0.09/10 + z²/400)) / (1 + z²/10)
    assert (found.share, found.low, found.high) == pytest.approx((0.9, 0.5958500, 0.9821238), abs=1e-6)


@pytest.mark.parametrize("runs", [5, 20, 50])
def test_the_interval_of_a_share_covers_it_as_often_as_it_says_on_average_over_all_shares(runs: int) -> None:
    intervals = [share_of(successes, runs, 0.95) for successes in range(runs + 1)]
    truths = np.linspace(0.005, 0.995, 199)
    covered = np.zeros_like(truths)
    for successes, found in enumerate(intervals):
        assert found.low is not None
        assert found.high is not None
        covered += binom.pmf(successes, runs, truths) * ((truths >= found.low) & (truths <= found.high))
    assert np.mean(covered) == pytest.approx(0.95, abs=0.01)
    assert np.min(covered) > 0.83


@pytest.mark.parametrize("confidence", [0.8, 0.95])
def test_the_interval_of_a_mean_covers_that_of_a_normal_distribution_as_often_as_it_says(
    confidence: float,
) -> None:
    draw = np.random.default_rng(7).normal(10.0, 2.0, (4000, 4))
    found = [mean_of(sample, confidence) for sample in draw.tolist()]
    covered = np.mean([(one.low or 0.0) <= 10.0 <= (one.high or 0.0) for one in found])
    # three standard errors of a share of 4,000
    assert covered == pytest.approx(confidence, abs=3 * np.sqrt(confidence * (1 - confidence) / 4000))


def test_the_interval_of_a_skewed_mean_covers_it_a_little_less_often() -> None:
    draw = np.random.default_rng(7).exponential(1.0, (4000, 20))
    found = [mean_of(sample, 0.95) for sample in draw.tolist()]
    covered = np.mean([(one.low or 0.0) <= 1.0 <= (one.high or 0.0) for one in found])
    assert 0.90 < covered < 0.95


def test_of_fewer_than_two_runs_there_is_no_interval_and_of_none_no_mean() -> None:
    assert (share_of(1, 1, 0.95).share, share_of(1, 1, 0.95).low) == (1.0, None)
    assert (mean_of([2.0], 0.95).mean, mean_of([2.0], 0.95).high) == (2.0, None)
    assert share_of(0, 0, 0.95).share is mean_of([], 0.95).mean is None


def test_the_interval_of_what_cant_be_negative_isnt() -> None:
    found = mean_of([0.0, 0.0, 3.0], 0.95)
    assert found.low == 0.0
    assert found.high is not None
    assert found.high > 3.0
