"""What is left of a field tick by tick, by hand."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.protocol_report.residuals import CHANGE, DISAGREEMENT, ERROR, Residuals, Snapshots

ALL = np.ones(2, dtype=np.bool_)


def taken(limit: list[list[float]] | None, *fields: list[list[float]]) -> Residuals:
    residuals = Residuals(None if limit is None else np.array(limit))
    for tick, field in enumerate(fields):
        residuals.take(tick, np.array(field), ALL)
    return residuals


def test_change_is_to_the_tick_before_and_none_in_the_first() -> None:
    residuals = taken(None, [[0.0, 1.0], [2.0, 3.0]], [[3.0, 1.0], [2.0, 7.0]], [[3.0, 1.0], [2.0, 7.0]])
    np.testing.assert_array_equal(residuals.rms[CHANGE], [np.nan, 2.5, 0.0])
    np.testing.assert_array_equal(residuals.most[CHANGE], [np.nan, 4.0, 0.0])
    assert (residuals.moved, list(residuals.scale)) == (1, [3.0, 7.0, 7.0])
    assert list(residuals.rms) == [CHANGE]


def test_error_is_to_the_limit_and_disagreement_only_where_that_is_one_for_all() -> None:
    residuals = taken([[1.0], [1.0]], [[4.0], [1.0]])
    assert residuals.rms[ERROR][0] == pytest.approx(3 / np.sqrt(2))
    assert (residuals.rms[DISAGREEMENT][0], residuals.most[DISAGREEMENT][0]) == (1.5, 1.5)
    assert DISAGREEMENT not in taken([[1.0], [1.1]], [[4.0], [1.0]]).rms
    assert DISAGREEMENT in taken([[1.0, 5.0], [1.0, 5.0]], [[4.0, 5.0], [1.0, 5.0]]).rms


def test_the_dead_count_no_more_from_the_tick_they_die() -> None:
    residuals = taken([[0.0], [0.0]], [[1.0], [1.0]])
    residuals.take(1, np.array([[9.0], [1.5]]), np.array([False, True]))
    residuals.take(2, np.array([[0.0], [1.25]]), np.array([False, True]))
    assert list(residuals.most[CHANGE])[1:] == [0.5, 0.25]
    assert list(residuals.rms[ERROR]) == [1.0, 1.5, 1.25]
    assert list(residuals.rms[DISAGREEMENT]) == [0.0, 0.0, 0.0]


def test_numbers_that_are_none_are_left_out_and_far_that_stays_far_is_no_change() -> None:
    residuals = taken(None, [[np.nan], [np.inf]], [[1.0], [np.inf]], [[3.0], [np.inf]])
    np.testing.assert_array_equal(residuals.most[CHANGE], [np.nan, 0.0, 2.0])
    np.testing.assert_array_equal(taken(None, [[np.nan], [np.nan]]).rms[CHANGE], [np.nan])


def test_a_field_that_runs_away_has_residuals_as_long_as_it_has_numbers() -> None:
    residuals = taken(None, [[1e200], [0.0]], [[3e200], [0.0]])
    assert residuals.rms[CHANGE][1] == pytest.approx(2e200 / np.sqrt(2))


def test_snapshots_are_few_however_long_the_run_and_the_last_is_among_them() -> None:
    snapshots = Snapshots()
    for tick in range(20_001):
        snapshots.take(tick, 0.0, np.full((2, 1), float(tick)), ALL)
    assert len(snapshots.retained) < 60
    chosen = snapshots.chosen(6)
    assert (len(chosen), chosen[0][0], chosen[-1][0]) == (6, 0, 20_000)
    assert chosen == sorted(chosen, key=lambda one: one[0])
    assert all(field[0, 0] == tick for tick, field in chosen)


def test_snapshots_are_chosen_where_the_field_moves() -> None:
    snapshots = Snapshots()
    for tick in range(10_000):
        snapshots.take(tick, 0.9**tick, np.zeros((2, 1)), ALL)
    ticks = [tick for tick, _ in snapshots.chosen(6)]
    assert ticks[4] < 30  # four of the five steps lie where nine tenths of the way are
    assert ticks[5] == 9_999


def test_a_short_run_shows_every_tick() -> None:
    snapshots = Snapshots()
    for tick in range(3):
        snapshots.take(tick, 1.0, np.zeros((2, 1)), ALL)
    assert [tick for tick, _ in snapshots.chosen(6)] == [0, 1, 2]
    assert Snapshots().chosen(6) == []
