"""Rest, what the cells sense, and what the plant says about itself."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from plant.effects.motors import MotorsSpec
from plant.errors import PlantError
from plant.monitors import RestDetector
from plant.plant import Plant
from tests.plant.scenes import MU, SECOND, TICK_NS, G, elliptic, members, parcel, spec, study, turned

KAPPA = MU * G


def test_a_sliding_parcel_is_at_rest_once_it_is_slow_and_stays_slow() -> None:
    plant = Plant(spec(parcel(position_m=(-0.1, 0.0), velocity_m_s=(0.3, 0.0))))
    trajectory = plant.trajectory(np.zeros((400, 2)), 10 * SECOND, TICK_NS)
    status = plant.status[0]
    assert status.state == "at_rest"
    # both the speed and what it loses in a second must be below a micrometre
    expected = np.log(KAPPA * 0.3 / 1e-6) / KAPPA
    assert status.time_s == pytest.approx(expected, abs=3 * TICK_NS * 1e-9)
    assert trajectory.state[-1, 0, 3] < 1e-6


@pytest.mark.parametrize(
    ("pitch_m", "given", "slow"),
    [(1e-3, None, 1e-8), (1e-3, 1e-6, 1e-6), (0.1, 1e-3, 1e-3), (0.1, None, 1e-6)],
)
def test_what_counts_as_rest_goes_with_the_pitch_or_is_said(
    pitch_m: float, given: float | None, slow: float
) -> None:
    scale, begun = pitch_m / 0.1, 10.0 * slow
    body = parcel(size_m=(0.54 * scale, 0.32 * scale), position_m=(0.0, 0.0), velocity_m_s=(begun, 0.0))
    scene = spec(body, pitch_m=pitch_m, tolerance=1e-14)
    plant = Plant(scene.model_copy(update={"rest_speed_m_s": given}))
    plant.trajectory(np.zeros((400, 2)), 3 * SECOND, TICK_NS)
    assert plant.status[0].state == "at_rest"
    assert plant.status[0].time_s == pytest.approx(np.log(KAPPA * 10.0) / KAPPA, abs=3 * TICK_NS * 1e-9)


@pytest.mark.parametrize("sampled", [False, True])
def test_rest_is_noted_alike_by_ticks_and_by_trajectories(sampled: bool) -> None:
    plant = Plant(spec(parcel(position_m=(-0.1, 0.0), velocity_m_s=(0.3, 0.0))))
    drives = np.zeros((400, 2))
    if sampled:
        plant.trajectory(drives, 2000 * TICK_NS, TICK_NS)
    else:
        for tick in range(1, 2001):
            plant.advance(drives, tick * TICK_NS)
    assert plant.status[0].state == "at_rest"
    assert plant.status[0].time_s == pytest.approx(np.log(KAPPA * 0.3 / 1e-6) / KAPPA, abs=3 * TICK_NS * 1e-9)


def test_a_parcel_that_turns_back_is_not_at_rest_for_an_instant() -> None:
    plant = Plant(spec(parcel(position_m=(0.3, 0.0), angle_rad=0.0)))
    drives = elliptic(plant)
    states = []
    for tick in range(1, 1200):
        plant.advance(drives, tick * TICK_NS)
        states.append(plant.status[0].state)
    speed = np.abs(plant.state[0, 3])
    assert set(states) == {"moving"}
    assert speed < 0.1


def test_a_resting_parcel_moves_when_its_wheels_do_and_says_since_when() -> None:
    plant = study()
    plant.advance(np.zeros((400, 2)), SECOND)
    assert plant.status[0].state == "at_rest"
    plant.advance(np.full((400, 2), 0.1), SECOND + TICK_NS)
    assert (plant.status[0].state, plant.status[0].time_s) == ("moving", 1.0)


def test_the_plant_comes_to_rest_in_an_elliptic_field_and_says_so() -> None:
    plant = Plant(spec(parcel(size_m=(0.68, 0.42))))
    plant.trajectory(elliptic(plant), 60 * SECOND, TICK_NS)
    assert plant.status[0].state == "at_rest"
    assert 10.0 < plant.status[0].time_s < 40.0


def _covered(plant: Plant, sensors: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Sensors inside any footprint, by the winding of its corners; those within 1e-9 m of an edge are left out."""
    points = plant.array.positions_m[:, None, :] + sensors[None]
    covered = np.zeros(points.shape[:2], dtype=bool)
    for corners, state in zip(plant.footprints_m, plant.state, strict=True):
        placed = turned(corners, state[2]) + state[:2]
        to = placed[None, None] - points[:, :, None]
        angle = np.arctan2(to[..., 1], to[..., 0])
        step = np.diff(np.concatenate([angle, angle[..., :1]], axis=-1), axis=-1)
        covered |= np.abs(((step + np.pi) % (2.0 * np.pi) - np.pi).sum(axis=-1)) > 3.0
    return covered


SENSORS = [(0.0, 0.0), (0.04, 0.04), (-0.04, 0.04), (-0.04, -0.04), (0.04, -0.04)]


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_presence_bits_are_the_points_inside_the_footprints(count: int) -> None:
    draw = np.random.default_rng(count)
    for _ in range(30):
        first = parcel(
            size_m=tuple(draw.uniform(0.3, 0.6, 2)),
            position_m=tuple(draw.uniform(-0.5, -0.4, 2)),
            angle_rad=float(draw.uniform(-4.0, 4.0)),
        )
        second = parcel(
            vertices_m=((0.0, 0.0), (0.6, 0.1), (0.4, 0.7)),
            position_m=tuple(draw.uniform(0.4, 0.5, 2)),
            angle_rad=float(draw.uniform(-4.0, 4.0)),
        )
        holes = tuple((int(r), int(c)) for r, c in {(3, 3), (15, 14), (4, 9)})
        plant = Plant(spec(first, second, sensors_m=tuple(SENSORS[:count]), missing=holes))
        sense, _ = plant.advance(draw.normal(size=(len(plant.array), 2)) * 0.2, TICK_NS)
        assert sense.presence.shape == (397, count)
        assert sense.encoder_m is None
        assert np.array_equal(sense.presence, _covered(plant, np.array(SENSORS[:count])))


def test_sensors_out_of_their_own_cell_are_sampled_where_they_are() -> None:
    far = ((0.35, 0.0), (0.0, -0.72))
    plant = Plant(spec(parcel(position_m=(0.1, 0.0)), sensors_m=far))
    assert np.array_equal(plant.sense().presence, _covered(plant, np.array(far)))


def test_a_sensor_under_the_very_edge_of_a_parcel_is_covered() -> None:
    plant = Plant(spec(parcel(size_m=(0.3, 0.3), position_m=(0.0, 0.0), angle_rad=0.0)))
    presence = plant.sense().presence[:, 0].reshape(20, 20)
    assert presence.sum() == 16
    assert np.all(presence[8:12, 8:12])


def test_presence_with_a_centred_sensor_is_the_support_set() -> None:
    plant = study()
    sense, _ = plant.advance(elliptic(plant), SECOND)
    assert np.array_equal(np.flatnonzero(sense.presence[:, 0]), members(plant))


def test_an_empty_array_of_parcels_senses_nothing() -> None:
    plant = Plant(spec())
    sense, events = plant.advance(np.ones((400, 2)), SECOND)
    assert not sense.presence.any()
    assert events == []
    assert plant.state.shape == (0, 6)
    assert plant.trajectory(np.ones((400, 2)), 2 * SECOND, SECOND).state.shape == (2, 0, 6)


def test_encoders_count_what_the_motors_turned_in_closed_form() -> None:
    motors = MotorsSpec(time_constant_s=0.05, speed_per_volt_m_s=0.1, supply_v=6.0)
    plant = Plant(spec(parcel(), motors=motors))
    draw = np.random.default_rng(3)
    speed, travel = np.zeros((400, 2)), np.zeros((400, 2))
    node, weight = np.polynomial.legendre.leggauss(12)
    for tick in range(1, 80):
        volts = draw.normal(size=(400, 2)) * 8.0
        sense, _ = plant.advance(volts, tick * TICK_NS)
        steady = 0.1 * np.clip(volts, -6.0, 6.0)
        h = TICK_NS * 1e-9
        inside = [steady + (speed - steady) * np.exp(-0.5 * h * (1.0 + t) / 0.05) for t in node]
        travel += 0.5 * h * sum(w * v for w, v in zip(weight, inside, strict=True))
        speed = steady + (speed - steady) * np.exp(-h / 0.05)
        assert sense.encoder_m is not None
        assert sense.encoder_m == pytest.approx(travel, abs=1e-14)
        assert plant.wheel_speed == pytest.approx(speed, abs=1e-14)


def test_a_step_of_voltage_turns_the_wheel_by_the_textbook_response() -> None:
    motors = MotorsSpec(time_constant_s=0.06, speed_per_volt_m_s=0.1, supply_v=12.0)
    plant = Plant(spec(parcel(), motors=motors))
    assert np.all(plant.wheel_speed == 0.0)
    assert np.all(plant.sense().encoder_m == 0.0)
    sense, _ = plant.advance(np.full((400, 2), 20.0), 300_000_000)
    assert plant.wheel_speed == pytest.approx(1.2 * -np.expm1(-5.0), rel=1e-14)
    assert sense.encoder_m == pytest.approx(1.2 * (0.3 + 0.06 * np.expm1(-5.0)), rel=1e-13)


def test_ideal_wheels_run_as_commanded() -> None:
    plant = study()
    drives = np.random.default_rng(1).normal(size=(400, 2))
    plant.advance(drives, TICK_NS)
    assert np.array_equal(plant.wheel_speed, drives)


@pytest.mark.parametrize("policy", ["brake", "hold"])
def test_braked_and_held_wheels_act_as_they_are_driven(policy: str) -> None:
    plain, lost = study(), study()
    lost.release_wheels(range(200, 300), policy)  # type: ignore[arg-type]
    for plant in (plain, lost):
        plant.advance(elliptic(plant), SECOND)
    assert np.array_equal(plain.state, lost.state)


def test_wheels_lost_one_after_the_other_all_coast() -> None:
    one, two = study(), study()
    one.release_wheels([200, 201, 256], "coast")
    two.release_wheels([200], "coast")
    two.release_wheels([256, 201], "coast")
    two.release_wheels([7], "hold")
    for plant in (one, two):
        plant.advance(elliptic(plant), SECOND)
    assert np.array_equal(one.state, two.state)


def test_a_footprint_is_about_the_centre_of_mass() -> None:
    plant = Plant(spec(parcel(size_m=(0.4, 0.2), centre_of_mass_m=(0.1, 0.0))))
    assert plant.footprints_m[0][0].tolist() == pytest.approx([-0.3, -0.1])


def test_a_state_handed_out_is_the_holders_own() -> None:
    plant = study()
    plant.state[:] = 0.0
    plant.footprints_m[0][:] = 0.0
    assert plant.state[0, 0] == 0.55
    assert plant.footprints_m[0].max() == 0.27


def test_time_is_whole_nanoseconds() -> None:
    plant = study()
    assert plant.time_ns == 0
    plant.advance(elliptic(plant), 123_456_789)
    assert plant.time_ns == 123_456_789


def test_advancing_to_now_changes_nothing() -> None:
    plant = study()
    plant.advance(elliptic(plant), SECOND)
    before = plant.state
    _, events = plant.advance(elliptic(plant), SECOND)
    assert np.array_equal(plant.state, before)
    assert events == []


def test_drives_of_another_array_are_refused() -> None:
    with pytest.raises(
        PlantError, match=r"drives have shape \(3, 2\): the array has 400 cells of two wheels"
    ):
        study().advance(np.zeros((3, 2)), SECOND)


def test_a_time_in_the_past_is_refused() -> None:
    plant = study()
    plant.advance(elliptic(plant), SECOND)
    with pytest.raises(PlantError, match="until_ns = 999999999 is in the past: it is 1000000000 ns already"):
        plant.advance(elliptic(plant), SECOND - 1)


def test_events_name_their_cell_its_place_and_their_time_in_order() -> None:
    plant = study()
    _, first = plant.advance(elliptic(plant), SECOND)
    _, then = plant.advance(elliptic(plant), 2 * SECOND)
    events = first + then
    times = [event.time_s for event in events]
    assert times == sorted(times)
    assert all(event.time_s <= 1.0 for event in first)
    assert all(1.0 < event.time_s <= 2.0 for event in then)
    for event in events:
        (cell,) = event.cells
        place = plant.array.positions_m[plant.array.lattice.index(cell)]
        assert event.position_m == tuple(place)
        assert event.parcel == 0


@pytest.mark.parametrize("sampled", [False, True])
def test_drives_that_are_changed_afterwards_or_read_only_change_nothing(sampled: bool) -> None:
    plant, drives = study(), np.full((400, 2), 0.1)

    def move(until_ns: int) -> None:
        if sampled:
            plant.trajectory(drives, until_ns, TICK_NS)
        else:
            plant.advance(drives, until_ns)

    move(TICK_NS)
    drives[:] = np.nan
    np.testing.assert_array_equal(plant.wheel_speed, np.full((400, 2), 0.1))
    drives = np.full((400, 2), 0.2)
    drives.setflags(write=False)
    move(2 * TICK_NS)
    np.testing.assert_array_equal(plant.wheel_speed, drives)


_speeds = st.one_of(
    st.sampled_from([0.0, -0.0, 0.5e-6, -1e-6, 1e-6, 2e-6, np.inf, -np.inf, np.nan]), st.floats(-3e-6, 3e-6)
)


@given(
    speeds=arrays(np.float64, (2, 3, 3), elements=_speeds),
    resting=arrays(np.bool_, 3),
    radius=arrays(np.float64, 3, elements=st.floats(0.0, 3.0)),
    which=st.sets(st.sampled_from(range(3))),
    span_ns=st.sampled_from([0, 1, TICK_NS, 3 * SECOND]),
)
def test_changes_of_rest_are_looked_for_in_exactly_the_ticks_that_have_some(
    speeds: NDArray[np.float64],
    resting: NDArray[np.bool_],
    radius: NDArray[np.float64],
    which: set[int],
    span_ns: int,
) -> None:
    detector = RestDetector(radius, 1e-6)
    detector._resting[:] = resting
    states, watched = np.concatenate([np.zeros_like(speeds), speeds], axis=2), np.array(sorted(which), int)
    found = detector.any_changes(states[0], states[1], span_ns, watched)
    with np.errstate(invalid="ignore"):
        assert found == bool(detector.changes(states, np.array([0, span_ns]), watched))
