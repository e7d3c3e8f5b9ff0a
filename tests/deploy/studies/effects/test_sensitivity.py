"""How far two runs are apart, by hand."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import combinations

import numpy as np
import pytest

from deploy.runs.result import RunResult
from deploy.studies.effects.run import TracedRun
from deploy.studies.effects.sensitivity import compare, match
from plant.observations import Event, ParcelState, ParcelStatus

SQUARE = np.array([[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [-0.1, 0.1]])


TICK_NS = 4_000_000


def result(
    *poses: tuple[float, float, float],
    fates: Sequence[tuple[ParcelState, float]] | None = None,
    events: Sequence[Event] = (),
    before: Sequence[Sequence[tuple[float, float, float]]] = (),
    tick_ns: int = TICK_NS,
) -> TracedRun:
    """A run whose last tick ends with ``poses``; ``before``: poses of all parcels at the ends of earlier ticks."""
    path = np.zeros((len(before) + 1, len(poses), 6))
    for number, there in enumerate((*before, poses)):
        path[number, :, :3] = np.reshape(there, (-1, 3))
    return TracedRun(
        RunResult(
            status="ok",
            reason="",
            state=path[-1],
            parcel_status=[ParcelStatus(*fate) for fate in fates or [("moving", 0.0)] * len(poses)],
            footprints_m=[SQUARE] * len(poses),
            events=events,
            wall_s=1.0,
        ),
        tick_ns * np.arange(1, len(path) + 1),
        path,
    )


def gained(time_s: float, row: int, parcel: int = 0, kind: str = "support_gained") -> Event:
    return Event(time_s, kind, parcel, ((row, 0),), (0.0, 0.0))


def test_a_run_is_no_distance_from_itself() -> None:
    one = result((0.1, 0.2, 0.3), events=[gained(1.0, 2)])
    found = compare(one, one)
    assert found.none
    assert (found.displacement_m, found.turn_rad, found.moved_s, found.only) == (0.0, 0.0, 0.0, (0, 0))


def test_a_parcel_carried_aside_is_displaced_by_that_much_at_every_corner() -> None:
    found = compare(result((0.3, 0.4, 0.7)), result((0.0, 0.0, 0.7)))
    assert found.displacement_m == pytest.approx(0.5, rel=1e-12)
    assert found.turn_rad == 0.0


def test_a_parcel_turned_on_the_spot_is_displaced_by_the_chord_of_its_corners() -> None:
    found = compare(result((0.0, 0.0, 0.5)), result((0.0, 0.0, 0.1)))
    assert found.displacement_m == pytest.approx(2.0 * 0.1 * math.sqrt(2.0) * math.sin(0.2), rel=1e-12)
    assert found.turn_rad == pytest.approx(0.4, rel=1e-12)


def test_a_full_turn_more_is_the_same_pose() -> None:
    found = compare(result((0.0, 0.0, 0.5 + math.tau)), result((0.0, 0.0, 0.5)))
    assert found.turn_rad == pytest.approx(0.0, abs=1e-14)
    assert found.displacement_m == pytest.approx(0.0, abs=1e-14)


def test_the_farthest_parcel_counts() -> None:
    found = compare(result((0.0, 0.0, 0.0), (1.0, 0.0, 0.0)), result((0.1, 0.0, 0.0), (1.4, 0.0, 0.0)))
    assert found.displacement_m == pytest.approx(0.4, rel=1e-12)


def test_events_are_matched_by_kind_parcel_and_cells_in_their_order() -> None:
    one = [gained(1.0, 1), gained(2.0, 1), gained(3.0, 2), gained(4.0, 3, parcel=1)]
    other = [gained(1.1, 1), gained(2.4, 1), gained(9.0, 2, kind="support_lost"), gained(4.0, 3)]
    found = compare(result((0.0, 0.0, 0.0), events=one), result((0.0, 0.0, 0.0), events=other))
    assert found.events == 2
    assert found.moved_s == pytest.approx(0.4)
    assert found.only == (2, 2)
    assert not found.none


def test_the_largest_displacement_counts_though_it_is_gone_at_the_end() -> None:
    one = result((1.0, 0.0, 0.0), (2.0, 0.0, 0.0), before=[[(0.0, 0.0, 0.0), (0.0, 0.3, 0.0)]] * 2)
    other = result((1.0, 0.1, 0.0), (2.0, 0.0, 0.0), before=[[(0.0, 0.0, 0.0)] * 2, [(0.0, 0.0, 0.2)] * 2])
    found = compare(one, other)
    c, s = math.cos(0.2), math.sin(0.2)
    corner = max(math.hypot(x - (x * c - y * s), 0.3 + y - (x * s + y * c)) for x, y in SQUARE)
    assert found.displacement_m == pytest.approx(corner, rel=1e-12)
    assert (found.at_s, found.parcel) == (pytest.approx(0.008), 1)
    assert found.turn_rad == pytest.approx(0.2, rel=1e-12)
    assert found.end_m == pytest.approx(0.1, rel=1e-12)
    assert found.end_rad == 0.0


def test_runs_with_ticks_of_other_lengths_are_compared_where_both_have_one() -> None:
    halves = result(
        (0.4, 0.0, 0.0),
        before=[[(0.9, 0.0, 0.0)], [(0.2, 0.0, 0.0)], [(0.9, 0.0, 0.0)]],
        tick_ns=TICK_NS // 2,
    )
    found = compare(halves, result((0.4, 0.0, 0.0), before=[[(0.0, 0.0, 0.0)]]))
    assert found.displacement_m == pytest.approx(0.2, rel=1e-12)
    assert found.at_s == pytest.approx(0.004)


def test_a_parcel_is_compared_only_while_it_is_there_in_both_runs() -> None:
    absent = (math.nan,) * 3
    late = result((0.3, 0.0, 0.0), before=[[absent], [(5.0, 0.0, 0.0)]])
    found = compare(late, result((0.1, 0.0, 0.0), before=[[(9.0, 0.0, 0.0)], [absent]]))
    assert found.displacement_m == pytest.approx(0.2, rel=1e-12)


def test_an_event_more_doesn_t_shift_those_that_follow() -> None:
    assert match([1.0, 2.0, 3.0], [0.5, 1.1, 2.0, 3.0]) == [(1.0, 1.1), (2.0, 2.0), (3.0, 3.0)]
    assert match([0.5, 1.1, 2.0, 3.0], [1.0, 2.0, 3.0]) == [(1.1, 1.0), (2.0, 2.0), (3.0, 3.0)]


def test_no_match_in_order_has_a_lesser_largest_shift() -> None:
    draw = np.random.default_rng(7)
    for _ in range(200):
        few, many = np.sort(draw.random(draw.integers(0, 5))), np.sort(draw.random(draw.integers(5, 8)))
        found = match(few.tolist(), many.tolist())
        assert [one for one, _ in found] == few.tolist()
        assert sorted(set(found)) == found
        known = min(
            max(map(abs, few - chosen), default=0.0) for chosen in map(np.array, combinations(many, len(few)))
        )
        assert max((abs(one - other) for one, other in found), default=0.0) == pytest.approx(known, abs=1e-11)


def test_all_rest_when_the_last_does() -> None:
    rest = [("at_rest", 1.0), ("tipped", 2.5)]
    later = [("at_rest", 3.0), ("at_rest", 0.5)]
    still = [("at_rest", 3.0), ("moving", 0.0)]
    poses = ((0.0, 0.0, 0.0), (1.0, 0.0, 0.0))
    found = compare(result(*poses, fates=later), result(*poses, fates=rest))
    assert found.settled_s == (3.0, 2.5)
    assert found.settling_s == 0.5
    assert compare(result(*poses, fates=still), result(*poses, fates=rest)).settled_s == (None, 2.5)
    assert compare(result(*poses, fates=still), result(*poses, fates=rest)).settling_s is None


def test_a_parcel_that_is_there_on_one_side_only_is_counted_and_not_measured() -> None:
    left = Event(1.0, "left", 1, (), (0.0, 0.0), "exit")
    one = result(
        (0.0, 0.0, 0.0),
        (math.nan,) * 3,
        (math.nan,) * 3,
        fates=[("moving", 0.0), ("delivered", 1.0), ("waiting", 0.0)],
        events=[left],
    )
    other = result((0.1, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0))
    found = compare(one, other)
    assert found.parcels == 2
    assert found.displacement_m == pytest.approx(0.1)
    assert found.end_m == pytest.approx(0.1)
    for nobody in (compare(result(), other), compare(other, result())):
        assert (nobody.parcels, nobody.displacement_m, nobody.turn_rad, nobody.end_m) == (3, None, None, None)
    assert not nobody.none
