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


def test_mass_drops_out() -> None:
    light, heavy = (Plant(spec(parcel(mass_kg=mass))) for mass in (0.02, 2000.0))
    for plant in (light, heavy):
        plant.advance(elliptic(plant), 10 * SECOND)
    assert light.state == pytest.approx(heavy.state, abs=1e-12)


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


def _energy(state: np.ndarray, inertia_over_mass: float) -> np.ndarray:
    return state[:, 3] ** 2 + state[:, 4] ** 2 + inertia_over_mass * state[:, 5] ** 2


@pytest.mark.parametrize("coasting", [0, 150])
def test_with_stopped_wheels_kinetic_energy_never_rises(coasting: int) -> None:
    body = parcel(
        position_m=(-0.4, -0.2),
        velocity_m_s=(1.2, 0.5),
        angular_velocity_rad_s=6.0,
        centre_of_mass_m=(0.08, 0.03),
        inertia_kg_m2=0.09,
    )
    plant = Plant(spec(body))
    plant.lose([int(i) for i in np.random.default_rng(1).choice(400, coasting, replace=False)], "coast")
    state = plant.trajectory(np.zeros((400, 2)), 2 * SECOND, 1_000_000).state[:, 0]
    energy = _energy(state, 0.045)
    assert np.all(np.diff(energy) <= 1e-15)
    assert energy[-1] < 0.2 * energy[0]


def test_a_shift_by_a_thousand_kilometres_changes_nothing_but_digits() -> None:
    size = 10_000
    block = tuple((9_980 + r, 9_980 + c) for r in range(20) for c in range(20))
    near = Plant(spec(parcel(), pitch_m=0.125))
    far_spec = spec(rows=size, columns=size, pitch_m=0.125, cells=block)
    shift = 0.125 * (9_980 + 9.5 - 0.5 * (size - 1))
    body = parcel(position_m=(0.55 + shift, 0.5 + shift))
    far = Plant(far_spec.model_copy(update={"parcels": (body,)}))
    near.advance(near.array.positions_m * (-1.0, -2.0), 3 * SECOND)
    far.advance((far.array.positions_m - shift) * (-1.0, -2.0), 3 * SECOND)
    moved = far.state - [shift, shift, 0, 0, 0, 0]
    assert moved == pytest.approx(near.state, abs=1e-9)
    assert near.support_changes == far.support_changes


def _run(position: tuple[float, float], angle: float, field: np.ndarray, spin: float) -> np.ndarray:
    body = parcel(
        position_m=position, angle_rad=angle, angular_velocity_rad_s=spin, centre_of_mass_m=(0.05, 0.0)
    )
    plant = Plant(spec(body))
    plant.advance(plant.array.positions_m @ field.T, 3 * SECOND)
    assert plant.support_changes > 20
    return plant.state[0]


FIELD = np.array([[-1.0, 0.4], [0.1, -1.7]])


@pytest.mark.parametrize("quarter", [1, 2, 3])
def test_a_quarter_turn_of_everything_turns_the_motion(quarter: int) -> None:
    turn = np.linalg.matrix_power(np.array([[0.0, -1.0], [1.0, 0.0]]), quarter)
    place = turn @ (0.3, 0.2)
    plain = _run((0.3, 0.2), 0.9, FIELD, 0.5)
    other = _run((float(place[0]), float(place[1])), 0.9 + quarter * np.pi / 2.0, turn @ FIELD @ turn.T, 0.5)
    assert other[:2] == pytest.approx(turn @ plain[:2], abs=1e-11)
    assert other[3:5] == pytest.approx(turn @ plain[3:5], abs=1e-11)
    assert other[2] - quarter * np.pi / 2.0 == pytest.approx(plain[2], abs=1e-10)
    assert other[5] == pytest.approx(plain[5], abs=1e-10)


def test_a_mirror_mirrors_the_motion() -> None:
    mirror = np.diag([1.0, -1.0])
    plain = _run((0.3, 0.2), 0.9, FIELD, 0.5)
    other = _run((0.3, -0.2), -0.9, mirror @ FIELD @ mirror, -0.5)
    assert other == pytest.approx(plain * [1, -1, -1, 1, -1, -1], abs=1e-10)


def test_a_whole_turn_of_the_start_angle_changes_nothing_but_digits() -> None:
    plain, other = _run((0.3, 0.2), 0.9, FIELD, 0.5), _run((0.3, 0.2), 0.9 + 2.0 * np.pi, FIELD, 0.5)
    assert other - [0, 0, 2.0 * np.pi, 0, 0, 0] == pytest.approx(plain, abs=1e-11)


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
