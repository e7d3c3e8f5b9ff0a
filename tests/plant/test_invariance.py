"""What must not change the motion, and what it may never do."""

from __future__ import annotations

import numpy as np
import pytest

from plant.geometry import rectangle
from plant.plant import Plant
from tests.plant.scenes import SECOND, TICK_NS, elliptic, parcel, spec, study, turned


def _corner_error(a: np.ndarray, b: np.ndarray) -> float:
    """Largest displacement of any corner of the study scene's footprint between two states, m."""
    corners = np.array(rectangle(0.54, 0.32))
    first, second = turned(corners, a[2]) + a[:2], turned(corners, b[2]) + b[:2]
    return float(np.max(np.hypot(*(first - second).T)))


def test_gravity_and_friction_count_only_as_their_product() -> None:
    plants = []
    for mu, g in ((0.2, 9.81), (0.4, 4.905)):
        scene = spec(parcel(), mu=mu).model_copy(update={"gravity_m_s2": g})
        plants.append(Plant(scene))
        plants[-1].advance(elliptic(plants[-1]), 5 * SECOND)
    assert np.array_equal(plants[0].state, plants[1].state)


@pytest.mark.parametrize("capture_m", [1e-6, 1e-12])
def test_one_advance_of_ten_seconds_equals_2442_ticks(capture_m: float) -> None:
    whole, ticks = study(tolerance=1e-9, capture_m=capture_m), study(tolerance=1e-9, capture_m=capture_m)
    drives = elliptic(whole)
    whole.advance(drives, 10 * SECOND)
    for until in [*range(TICK_NS, 10 * SECOND, TICK_NS), 10 * SECOND]:
        ticks.advance(drives, until)
    assert whole.state == pytest.approx(ticks.state, abs=1e-9)
    assert whole.support_changes == ticks.support_changes


def test_a_trajectory_passes_through_the_states_of_single_advances() -> None:
    sampled, single = study(), study()
    drives = elliptic(sampled)
    trajectory = sampled.trajectory(drives, 1_234_567_890, 100_000_000)
    assert trajectory.time_ns.tolist() == [*range(0, 1_234_567_890, 100_000_000), 1_234_567_890]
    assert trajectory.state.shape == (14, 1, 6)
    for k, until in enumerate(trajectory.time_ns.tolist()):
        if k > 0:
            single.advance(drives, until)
        assert trajectory.state[k] == pytest.approx(single.state, abs=1e-12)
    assert np.array_equal(trajectory.state[-1], sampled.state)
    assert sampled.time_ns == 1_234_567_890


def test_a_sampled_trajectory_ends_where_an_unsampled_advance_does_to_the_last_bit() -> None:
    sampled, whole = study(), study()
    sampled.trajectory(elliptic(sampled), 3 * SECOND, TICK_NS)
    whole.advance(elliptic(whole), 3 * SECOND)
    assert np.array_equal(sampled.state, whole.state)


def test_the_same_scene_gives_the_same_bits() -> None:
    first, second = study(), study()
    for plant in (first, second):
        plant.advance(elliptic(plant), 10 * SECOND)
    assert np.array_equal(first.state, second.state)


@pytest.mark.parametrize("tolerance", [1e-4, 1e-6, 1e-8, 1e-10, 1e-12])
def test_the_error_stays_within_ten_tolerances(tolerance: float) -> None:
    exact, plant = study(tolerance=1e-14), study(tolerance=tolerance)
    drives = elliptic(plant)
    true = exact.trajectory(drives, 10 * SECOND, 100_000_000).state[:, 0]
    found = plant.trajectory(drives, 10 * SECOND, 100_000_000).state[:, 0]
    worst = max(_corner_error(a, b) for a, b in zip(true, found, strict=True))
    assert worst <= 10.0 * tolerance


@pytest.mark.parametrize("tolerance", [1e-4, 1e-8, 1e-12])
def test_the_error_stays_within_ten_tolerances_tick_by_tick(tolerance: float) -> None:
    exact, plant = study(tolerance=1e-14), study(tolerance=tolerance)
    drives = elliptic(plant)
    exact.advance(drives, 3 * SECOND)
    for until in [*range(TICK_NS, 3 * SECOND, TICK_NS), 3 * SECOND]:
        plant.advance(drives, until)
    assert _corner_error(exact.state[0], plant.state[0]) <= 10.0 * tolerance


def test_the_direction_round_and_the_first_corner_of_a_polygon_do_not_matter() -> None:
    corners = ((-0.27, -0.16), (0.3, -0.1), (0.25, 0.2), (-0.2, 0.22))
    states = []
    for given in (corners, corners[::-1], corners[2:] + corners[:2]):
        plant = Plant(spec(parcel(vertices_m=given, position_m=(0.3, 0.2))))
        plant.advance(elliptic(plant), 3 * SECOND)
        states.append(plant.state)
    assert states[1] == pytest.approx(states[0], abs=1e-11)
    assert states[2] == pytest.approx(states[0], abs=1e-11)


def test_cells_far_from_the_parcel_change_nothing() -> None:
    small = Plant(spec(parcel(position_m=(0.2, 0.1)), rows=14, columns=14, pitch_m=0.125))
    large = Plant(spec(parcel(position_m=(0.2, 0.1)), rows=40, columns=60, pitch_m=0.125))
    for plant in (small, large):
        plant.advance(elliptic(plant), 5 * SECOND)
    assert small.state == pytest.approx(large.state, abs=1e-13)
    assert small.support_changes == large.support_changes


def test_other_parcels_far_away_change_nothing() -> None:
    alone = Plant(spec(parcel(position_m=(0.3, 0.2))))
    other = parcel(size_m=(0.2, 0.2), position_m=(-0.6, -0.6), angle_rad=0.3)
    pair = Plant(spec(other, parcel(position_m=(0.3, 0.2))))
    drives = elliptic(alone)
    drives[np.all(alone.array.positions_m < -0.4, axis=1)] = 0.0
    for plant in (alone, pair):
        plant.advance(drives, SECOND)
    assert np.array_equal(alone.state[0], pair.state[1])
