"""Which bodies may meet: the same pairs as comparing all with all, without doing so."""

from __future__ import annotations

import time
from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from plant.geometry import close_boxes, close_pairs

COORDINATE = st.sampled_from([-1.0, -0.5, 0.0, 0.25, 0.5, 1.0, 3.0])


@settings(max_examples=60)
@given(arrays(np.float64, st.tuples(st.integers(0, 12), st.just(3)), elements=COORDINATE))
def test_the_pairs_of_discs_are_those_of_all_with_all_in_lexical_order(discs: np.ndarray) -> None:
    centre, radius = discs[:, :2], np.abs(discs[:, 2])
    expected = [
        [i, j]
        for i, j in combinations(range(len(discs)), 2)
        if np.hypot(*(centre[i] - centre[j])) < radius[i] + radius[j]
    ]
    assert close_pairs(centre, radius).tolist() == expected


@settings(max_examples=60)
@given(arrays(np.float64, st.tuples(st.integers(0, 12), st.just(4)), elements=COORDINATE))
def test_the_pairs_of_boxes_are_those_of_all_with_all(boxes: np.ndarray) -> None:
    low = boxes[:, :2]
    high = low + np.abs(boxes[:, 2:])
    expected = [
        [i, j]
        for i, j in combinations(range(len(boxes)), 2)
        if np.all(low[i] < high[j]) and np.all(low[j] < high[i])
    ]
    assert close_boxes(low, high).tolist() == expected


@pytest.mark.parametrize("axis", [0, 1])
def test_ten_thousand_discs_in_a_row_are_swept_not_compared_all_with_all(axis: int) -> None:
    centre = np.zeros((10_000, 2))
    centre[:, axis] = np.random.default_rng(1).permutation(10_000)
    began = time.process_time()
    pairs = close_pairs(centre, np.full(10_000, 0.6))
    assert time.process_time() - began < 1.0  # 50 million pairs would take several times that
    assert len(pairs) == 9_999


@pytest.mark.parametrize("seed", range(20))
def test_boxes_of_all_sizes_anywhere_make_the_pairs_of_all_with_all(seed: int) -> None:
    draw = np.random.default_rng(seed)
    count = int(draw.integers(2, 120))
    low = draw.normal(0.0, draw.choice([1.0, 5.0, 20.0]), (count, 2))
    high = low + draw.exponential(1.0, (count, 2)) * draw.choice([0.0, 0.1, 1.0, 10.0], (count, 1))
    expected = [
        [i, j]
        for i, j in combinations(range(count), 2)
        if np.all(low[i] < high[j]) and np.all(low[j] < high[i])
    ]
    assert close_boxes(low, high).tolist() == expected


def test_a_crowd_all_over_the_plane_is_cut_into_strips() -> None:
    count = 100_000
    centre = np.random.default_rng(1).uniform(0.0, count**0.5, (count, 2))
    began = time.process_time()
    pairs = close_pairs(centre, np.full(count, 0.3))
    assert time.process_time() - began < 2.0  # one sweep along an axis takes several times that
    assert 50_000 < len(pairs) < 65_000
