"""How far trajectories are apart: displacement of corners, events matched, distributions."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.studies.accuracy.errors import (
    WINDOW_S,
    compare_events,
    corner_speeds,
    displacement_m,
    distribution_distance,
)
from plant.observations import Event

CORNERS = np.array([[0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2], [0.3, -0.2]])


def event(time_s: float, kind: str = "support_gained", cell: int = 0, parcel: int = 0) -> Event:
    return Event(time_s, kind, parcel, ((0, cell),), (0.0, 0.0))


def placed(states: np.ndarray) -> np.ndarray:
    """Corners ``(T, 4, 2)`` of one parcel in the world."""
    c, s = np.cos(states[:, 2]), np.sin(states[:, 2])
    turn = np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)
    return np.einsum("tij,vj->tvi", turn, CORNERS) + states[:, None, :2]


def test_displacement_is_the_largest_distance_between_a_corner_and_itself() -> None:
    draw = np.random.default_rng(3)
    states, others = draw.standard_normal((2, 50, 1, 6))
    apart = placed(states[:, 0]) - placed(others[:, 0])
    known = np.hypot(apart[..., 0], apart[..., 1]).max(axis=1)
    assert displacement_m(states, others, [CORNERS]) == pytest.approx(known, rel=1e-13)


def test_displacement_of_nearly_equal_angles_does_not_cancel() -> None:
    states = np.zeros((1, 1, 6))
    states[0, 0, 2] = 1.0
    others = states.copy()
    others[0, 0, 2] += 2.0**-50
    assert displacement_m(states, others, [CORNERS]) == pytest.approx(
        np.hypot(0.3, 0.2) * 2.0**-50, rel=1e-12
    )


def test_the_parcel_that_is_farthest_off_counts() -> None:
    states = np.zeros((2, 2, 6))
    others = states.copy()
    others[1, 1, 0] = 0.25
    assert displacement_m(states, others, [CORNERS, CORNERS]).tolist() == [0.0, 0.25]


def test_a_crossing_and_its_mirror_that_are_not_seen_are_two_missed_events() -> None:
    known = [event(1.0, cell=1), event(2.0, cell=2), event(2.01, "support_lost", 2), event(3.0, cell=3)]
    found = compare_events([known[0], event(3.001, cell=3)], known, 10.0)
    assert (found.found, found.missed, found.invented) == (2, 2, 0)
    assert found.time_error_s == pytest.approx(0.001)
    assert found.order_until_s == 2.0


def test_an_event_too_far_off_in_time_or_of_another_parcel_is_missed_and_invented() -> None:
    for other in (
        event(1.0 + 1.1 * WINDOW_S),
        event(1.0, parcel=1),
        event(1.0, cell=4),
        event(1.0, "tipped"),
    ):
        found = compare_events([other], [event(1.0)], 10.0)
        assert (found.found, found.missed, found.invented, found.time_error_s) == (0, 1, 1, None)
        assert found.order_until_s == 1.0


def test_the_nearest_of_several_is_the_one_meant() -> None:
    found = compare_events([event(1.02)], [event(1.0), event(1.021)], 10.0)
    assert (found.found, found.missed) == (1, 1)
    assert found.time_error_s == pytest.approx(0.001)


def test_events_in_another_order_are_found_but_the_order_differs_from_there() -> None:
    known = [event(1.0, cell=1), event(2.0, cell=2), event(2.01, cell=3)]
    found = compare_events([known[0], event(2.012, cell=2), known[2]], known, 10.0)
    assert (found.found, found.missed, found.invented) == (3, 0, 0)
    assert found.order_until_s == pytest.approx(2.01)


def test_events_of_one_instant_have_no_order() -> None:
    known = [event(1.0, cell=1), event(1.0, cell=2)]
    assert compare_events([event(1.0, cell=2), event(1.00000001, cell=1)], known, 10.0).order_until_s is None
    apart = [event(1.0, cell=1), event(1.000001, cell=2)]
    at_once = [event(1.0000005, cell=1), event(1.0000005 - 5e-10, cell=2)]
    assert compare_events(at_once, apart, 10.0).order_until_s is None


def test_what_is_invented_and_taken_back_at_once_is_counted_but_changes_no_order() -> None:
    known = [event(1.0, "support_lost")]
    mine = [known[0], event(1.0), event(1.0, "support_lost")]
    found = compare_events(mine, known, 10.0)
    assert (found.found, found.missed, found.invented, found.order_until_s) == (1, 0, 2, None)


def test_loads_that_jump_with_the_supports_belong_to_their_change() -> None:
    known = [event(1.0), event(1.0, "load_vanished", 5), event(2.0, "load_vanished", 6)]
    found = compare_events([known[0]], known, 10.0)
    assert (found.found, found.missed) == (1, 1)
    assert found.order_until_s == 2.0


def test_remarks_and_what_comes_after_the_comparison_do_not_count() -> None:
    known = [event(1.0), event(5.0)]
    found = compare_events([event(1.0), event(1.5, "captured"), event(1.6, "outrun")], known, 4.0)
    assert (found.found, found.missed, found.invented) == (1, 0, 0)


def test_distance_of_distributions_is_that_of_scipy() -> None:
    stats = pytest.importorskip("scipy.stats")
    draw = np.random.default_rng(8)
    one, other = draw.standard_normal(80), np.round(draw.standard_normal(50) + 0.4, 1)
    assert distribution_distance(one, other) == pytest.approx(stats.ks_2samp(one, other).statistic)


def test_corner_speed_bounds_every_corner() -> None:
    draw = np.random.default_rng(4)
    states = draw.standard_normal((20, 1, 6))
    step = states.copy()
    step[..., :3] += 1e-7 * states[..., 3:]
    moved = np.linalg.norm(placed(step[:, 0]) - placed(states[:, 0]), axis=-1).max(axis=1) / 1e-7
    assert np.all(moved <= corner_speeds(states, [CORNERS]) * (1.0 + 1e-6))
