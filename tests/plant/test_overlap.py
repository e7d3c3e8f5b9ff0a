"""Parcels that come to overlap: noticed once, with the pair and the place, and their parting too."""

from __future__ import annotations

import numpy as np
import pytest

from plant.errors import PlantError
from plant.geometry import close_pairs, rectangle
from plant.overlap import NeighbourList, OverlapDetector
from plant.plant import Plant
from tests.plant.scenes import SECOND, TICK_NS, parcel, spec


def _watch(count: int = 3) -> OverlapDetector:
    box = np.array(rectangle(0.4, 0.2))
    return OverlapDetector([box] * count, np.full(count, float(np.hypot(0.2, 0.1))))


def _all(count: int) -> np.ndarray:
    return np.arange(count)


def _state(*poses: tuple[float, float, float]) -> np.ndarray:
    state = np.zeros((len(poses), 6))
    state[:, :3] = poses
    return state


def test_only_pairs_that_overlap_are_named_with_depth_and_place() -> None:
    found = list(_watch().pairs(_state((0, 0, 0), (0.375, 0, 0), (2, 0, 0)), _all(3)))
    assert [(i, j) for i, j, _, _ in found] == [(0, 1)]
    _, _, depth, place = found[0]
    assert depth == pytest.approx(0.025, rel=1e-12)
    assert place[0] == pytest.approx(0.1875, abs=0.0126)
    assert place[1] == pytest.approx(0.0, abs=0.1)


def test_near_circles_are_not_overlap() -> None:
    assert list(_watch(2).pairs(_state((0, 0, 0), (0, 0.21, 0)), _all(2))) == []
    assert len(list(_watch(2).pairs(_state((0, 0, 0), (0, 0.21, np.pi / 2)), _all(2)))) == 1


def test_the_first_blocker_is_the_first_present_parcel_that_would_be_overlapped() -> None:
    watch = _watch(4)
    # at the end of its length but not of its circle; across; a little aside; far
    state = _state((0, 0, 0), (0.399, 0, 0), (0.19, 0.09, 0), (3, 0, 0))
    assert watch.first_blocker(0, state, np.array([1, 2, 3])) == 1
    assert watch.first_blocker(0, state, np.array([2, 3])) == 2
    assert watch.first_blocker(0, state, np.array([3])) is None
    assert watch.first_blocker(0, state, np.zeros(0, dtype=np.int64)) is None
    touching = _state((0, 0, 0), (0.4, 0, 0), (0, 0.2, 0), (0.41, 0, np.pi / 4))
    assert watch.first_blocker(0, touching, np.array([1, 2])) is None
    assert watch.first_blocker(0, touching, np.array([1, 2, 3])) == 3


def test_an_overlap_is_reported_when_it_begins_and_when_it_ends() -> None:
    watch = _watch(2)
    apart, close = _state((0, 0, 0), (1, 0, 0)), _state((0, 0, 0), (0.3, 0, 0))
    kinds = [
        [change[0] for change in watch.changes(state, _all(2))]
        for state in (apart, close, close, apart, apart)
    ]
    assert kinds == [[], ["overlap"], [], ["apart"], []]


def test_close_calls_cover_every_instant_of_an_overlap_and_the_one_after() -> None:
    watch = _watch(2)
    distance = [1.0, 0.6, 0.3, 0.1, 0.3, 0.6, 1.0, 1.0]
    states = np.array([_state((0, 0, 0), (d, 0, 0)) for d in distance])
    candidates = set(watch.candidate_instants(states))
    overlapping = {k for k, d in enumerate(distance) if d < 0.4}
    assert overlapping | {max(overlapping) + 1} <= candidates


def test_one_parcel_alone_meets_nobody() -> None:
    watch = _watch(1)
    assert list(watch.pairs(_state((0, 0, 0)), _all(1))) == []
    assert watch.changes(_state((0, 0, 0)), _all(1)) == []
    assert list(watch.candidate_instants(np.zeros((4, 1, 6)))) == []


def _pair() -> Plant:
    left = parcel(size_m=(0.25, 0.25), position_m=(-0.4, 0.01), angle_rad=0.0)
    right = parcel(size_m=(0.25, 0.25), position_m=(0.4, 0.01), angle_rad=0.0)
    return Plant(spec(left, right))


def _together(plant: Plant) -> np.ndarray:
    x = plant.array.positions_m[:, 0]
    return np.stack([-0.2 * np.sign(x), 0.0 * x], axis=1)


def test_parcels_driven_together_are_reported_at_the_tick_in_which_they_meet() -> None:
    plant, alone = _pair(), _pair()
    drives, meetings = _together(plant), []
    for tick in range(1, 800):
        _, events = plant.advance(drives, tick * TICK_NS)
        meetings += [event for event in events if event.kind in ("overlap", "apart")]
    assert len(meetings) == 1
    event = meetings[0]
    assert (event.kind, event.parcel, event.detail[:13]) == ("overlap", 0, "with parcel 1")
    assert abs(event.position_m[0]) < 0.01
    # the centres are 0.25 m apart then: x'' = mu g (V - x') on each side while no wheel changes
    until = round(event.time_s * SECOND)
    alone.advance(drives, until - TICK_NS)
    assert alone.state[1, 0] - alone.state[0, 0] >= 0.25
    alone.advance(drives, until)
    assert alone.state[1, 0] - alone.state[0, 0] < 0.25


def test_a_trajectory_reports_the_meeting_at_a_sample() -> None:
    plant = _pair()
    trajectory = plant.trajectory(_together(plant), 3 * SECOND, TICK_NS)
    met = [event for event in trajectory.events if event.kind == "overlap"]
    assert len(met) == 1
    gap = trajectory.state[:, 1, 0] - trajectory.state[:, 0, 0]
    assert met[0].time_s == pytest.approx(trajectory.time_ns[np.argmax(gap < 0.25)] * 1e-9, abs=1e-12)


def test_parcels_that_overlap_at_the_start_are_refused_by_name_depth_and_place() -> None:
    first = parcel(size_m=(0.3, 0.3), position_m=(0.0, 0.0), angle_rad=0.0)
    second = parcel(size_m=(0.3, 0.3), position_m=(0.25, 0.02), angle_rad=0.0)
    with pytest.raises(
        PlantError, match=r"parcels\[0\] and parcels\[1\] overlap at the start by 0\.05 m near"
    ):
        Plant(spec(first, second))


def test_parcels_pass_through_each_other_unhindered() -> None:
    together, alone = (
        _pair(),
        Plant(spec(parcel(size_m=(0.25, 0.25), position_m=(-0.4, 0.01), angle_rad=0.0))),
    )
    drives = np.full((400, 2), (0.2, 0.0))
    drives[:, 0] *= -np.sign(together.array.positions_m[:, 0])
    together.advance(drives, 4 * SECOND)
    alone.advance(drives, 4 * SECOND)
    assert np.array_equal(together.state[0], alone.state[0])


def test_parcels_that_overlap_by_rounding_are_beside_each_other() -> None:
    first = parcel(size_m=(0.3, 0.3), position_m=(-0.7, 0.0), angle_rad=0.0)
    second = parcel(size_m=(0.3, 0.3), position_m=(-0.4, 0.0), angle_rad=0.0)
    assert -0.7 + 0.15 > -0.4 - 0.15  # by 1.1e-16
    plant = Plant(spec(first, second))
    _, events = plant.advance(np.zeros((400, 2)), TICK_NS)
    assert events == []
    with pytest.raises(PlantError, match="overlap at the start by 1e-08 m"):
        Plant(spec(first, second.model_copy(update={"position_m": (-0.4 - 1e-8, 0.0)})))


def test_remembered_neighbours_are_those_of_a_new_search() -> None:
    rng = np.random.default_rng(3)
    radius = rng.uniform(0.1, 0.5, 20)
    there, state, found = _all(20), np.zeros((20, 6)), 0
    neighbours = NeighbourList(radius)
    state[:, :2] = rng.uniform(-2.0, 2.0, (20, 2))
    for _ in range(300):
        state[:, :2] += rng.normal(scale=0.02, size=(20, 2))
        pairs = close_pairs(state[:, :2], radius)
        np.testing.assert_array_equal(neighbours.touching(state, there), pairs)
        found += len(pairs)
    assert found > 0
