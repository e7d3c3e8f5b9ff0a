"""The bundled scenes show what their titles say."""

from __future__ import annotations

from math import pi

import numpy as np
import pytest

from deploy.runs.field_simulation import field_speeds
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from plant.array import CellArray
from plant.plant import Plant


def at_the_end(name: str) -> tuple[float, float, float]:
    """``x, y, theta`` of the only parcel, from the plant alone."""
    scene = load_scene(name)
    plant = Plant(scene.plant_spec())
    plant.advance(field_speeds(scene, CellArray(scene.array).positions_m), scene.duration_ns)
    x, y, theta = plant.state[0, :3]
    return float(x), float(y), float(theta)


def test_the_elliptic_field_centres_its_parcel_and_turns_it_almost_straight() -> None:
    x, y, theta = at_the_end("elliptic")
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert theta == pytest.approx(0.0, abs=0.02)


def test_a_parcel_a_little_wider_rests_well_off_straight_in_the_same_field() -> None:
    elliptic, misaligned = load_scene("elliptic"), load_scene("misaligned")
    assert misaligned.cells == elliptic.cells
    assert misaligned.array == elliptic.array
    x, y, theta = at_the_end("misaligned")
    assert (x, y) == pytest.approx((0.0, 0.0), abs=1e-3)
    assert theta == pytest.approx(0.2315, abs=1e-3)


def test_the_squeeze_field_lays_its_parcel_along_the_line_where_it_came() -> None:
    x, y, theta = at_the_end("squeeze")
    assert (x, y) == pytest.approx((0.0, 0.3), abs=1e-3)
    assert theta == pytest.approx(pi / 2, abs=0.05)


def test_coulomb_carries_its_parcel_off_at_the_wheels_speed() -> None:
    scene = load_scene("coulomb")
    plant = Plant(scene.plant_spec())
    plant.advance(field_speeds(scene, plant.array.positions_m), scene.duration_ns)
    assert plant.state[0, 3:].tolist() == [0.2, 0.0, 0.0]


def test_the_stream_sends_every_parcel_through_the_exit_on_its_side() -> None:
    scene = load_scene("stream", [Override.parse("duration_s=12")])
    plant = Plant(scene.plant_spec())
    trajectory = plant.trajectory(field_speeds(scene, plant.array.positions_m), scene.duration_ns, 4_096_000)
    left = [event for event in trajectory.events if event.kind == "left"]
    assert len(left) > 2
    assert {event.position_m[1] > 0.0 for event in left} == {True, False}
    for event in left:
        side = "north" if trajectory.state[0, event.parcel, 1] > 0.0 else "south"
        assert event.detail.startswith(f"through exit {side} ")


def test_where_a_rolling_parcel_ends_depends_on_how_it_came() -> None:
    ends = []
    for speed in (0.2, 0.1):
        scene = load_scene("rolling", [Override.parse(f"parcels.0.velocity_m_s=[{speed},0]")])
        plant = Plant(scene.plant_spec())
        plant.advance(field_speeds(scene, plant.array.positions_m), scene.duration_ns)
        assert plant.status[0].state == "at_rest" or abs(plant.state[0, 3]) < 1e-6
        ends.append(float(plant.state[0, 0]))
    assert ends[0] == pytest.approx(2.0 * ends[1], rel=1e-3)
    assert ends[1] > 1e-4


def test_wheels_that_slip_bring_the_parcel_to_the_middle_along_another_path_than_rolling_ones() -> None:
    x, y, theta = at_the_end("stick_slip")
    assert (x, y) == pytest.approx((0.0, 0.0), abs=0.02)
    scene = load_scene("stick_slip", [Override.parse("friction.coefficient=1e6")])
    plant = Plant(scene.plant_spec())
    plant.advance(field_speeds(scene, plant.array.positions_m), scene.duration_ns)
    assert abs(plant.state[0, 2] - theta) > 1e-3


def test_all_fifty_parcels_of_large_follow_one_linear_map_and_never_meet() -> None:
    scene = load_scene("large")
    plant = Plant(scene.plant_spec())
    trajectory = plant.trajectory(
        field_speeds(scene, plant.array.positions_m), scene.duration_ns, 10 * scene.cells.period_ns
    )
    # in the complex plane z'' = kappa (w z - z'), w = rate + i rotation, from rest
    kappa, w = 0.2 * scene.gravity_m_s2, -0.12 + 0.4j
    root = np.sqrt(kappa * kappa + 4.0 * kappa * w)
    fast, slow = (-kappa - root) / 2.0, (-kappa + root) / 2.0
    t = scene.duration_ns * 1e-9
    factor = (fast * np.exp(slow * t) - slow * np.exp(fast * t)) / (fast - slow)
    start = np.array([complex(*parcel.position_m) for parcel in scene.parcels])
    assert len(start) == 50
    assert len(plant.array) == 10_000
    assert plant.state[:, 0] + 1j * plant.state[:, 1] == pytest.approx(factor * start, abs=1e-8)
    assert {status.state for status in plant.status} == {"moving"}
    assert plant.support_changes > 50_000
    assert not [event for event in trajectory.events if event.kind == "overlap"]
