"""Stable orientations of a parcel centred on a cell: where the torque of a field switches, and where it vanishes."""

from __future__ import annotations

import numpy as np
import pytest

from plant.constants import constants_of_motion
from plant.plant import Plant
from plant.specs import ParcelSpec, PlantSpec
from tests.plant.scenes import MU, SECOND, G, spec

LARGE, SMALL, SMALLEST = (10.3, 5.2), (6.3, 2.2), (4.3, 3.1)
FIELD = (-1.0, -0.5)


def _scene(size: tuple[float, float], angle: float, pitch: float = 1.0) -> PlantSpec:
    """A parcel about the middle cell of an odd array that reaches past it at any angle."""
    count = 2 * int(np.hypot(*size) / 2.0 / pitch + 2.0) + 1
    body = ParcelSpec(size_m=size, mass_kg=1.0, position_m=(0.0, 0.0), angle_rad=angle)
    return spec(body, rows=count, columns=count, pitch_m=pitch)


def _torque(size: tuple[float, float], degrees: np.ndarray, pitch: float = 1.0) -> np.ndarray:
    drives = None
    found = []
    for angle in np.radians(degrees):
        scene = _scene(size, float(angle), pitch)
        if drives is None:
            drives = Plant(scene).array.positions_m * FIELD
        found.append(constants_of_motion(scene, 0, drives).tau0_n_m)
    return np.array(found)


@pytest.mark.parametrize("stable", [84.46, 95.54, 264.46, 275.54])
def test_the_torque_of_the_large_parcel_switches_at_its_published_angles(stable: float) -> None:
    before, after = _torque(LARGE, np.array([stable - 0.01, stable + 0.01]))
    assert before > 1e-3
    assert after < -1e-3


@pytest.mark.parametrize(
    ("size", "low", "high"),
    [
        (LARGE, 175.19, 184.81),
        (LARGE, 355.19, 364.81),
        (SMALL, 88.08, 91.92),
        (SMALL, 268.08, 271.92),
    ],
)
def test_the_torque_vanishes_on_the_published_intervals(
    size: tuple[float, float], low: float, high: float
) -> None:
    inside = _torque(size, np.linspace(low + 0.02, high - 0.02, 25))
    outside = _torque(size, np.array([low - 0.02, high + 0.02]))
    assert np.abs(inside).max() < 1e-12
    assert np.abs(outside).min() > 1e-3


def test_the_smallest_parcel_has_plateaus_of_no_torque_and_no_angle_where_it_switches() -> None:
    torque = _torque(SMALLEST, np.arange(0.01, 180.0, 0.2))
    sign = np.where(np.abs(torque) < 1e-12, 0.0, np.sign(torque))
    assert set(sign) == {-1.0, 0.0, 1.0}
    assert np.all(sign[1:] * sign[:-1] >= 0.0)


def test_the_large_parcel_changes_supports_at_176_angles_a_turn() -> None:
    """A turn on the spot, on wheels that drive nothing: every change of the support set, merged by angle."""
    scene = _scene(LARGE, 0.05)
    body = scene.parcels[0].model_copy(update={"angular_velocity_rad_s": 1.0})
    plant = Plant(scene.model_copy(update={"parcels": (body,)}))
    plant.lose(range(len(plant.array)), "coast")
    drives = np.zeros((len(plant.array), 2))
    _, events = plant.advance(drives, round(2.0 * np.pi * SECOND))
    angles = np.array([event.time_s for event in events])
    assert plant.state[0, 5] == pytest.approx(1.0, abs=1e-12)
    assert 1 + int(np.sum(np.diff(angles) > 1e-9)) == 176


@pytest.mark.parametrize(("pitch", "published"), [(1.0, 0.0879), (0.5, 0.0257), (0.25, 0.0115)])
def test_the_torque_tends_to_that_of_the_continuous_field(pitch: float, published: float) -> None:
    count = int(600 * pitch)
    # irrational steps over half a turn stand for the fine grid the published figure was taken on
    degrees = (np.arange(count) * 180.0 * 0.6180339887498949) % 180.0
    length, width = LARGE
    weight = G
    continuous = MU * weight * (FIELD[1] - FIELD[0]) * (length**2 - width**2) / 24.0
    error = _torque(LARGE, degrees, pitch) - continuous * np.sin(2.0 * np.radians(degrees))
    assert np.sqrt(np.mean(error**2)) / abs(continuous) == pytest.approx(published, rel=0.1)


@pytest.mark.parametrize(("start", "stable"), [(70.0, 84.46), (110.0, 95.54)])
def test_the_large_parcel_turns_to_the_nearest_switching_angle_and_chatters_out_there(
    start: float, stable: float
) -> None:
    plant = Plant(_scene(LARGE, np.radians(start)))
    _, events = plant.advance(plant.array.positions_m * FIELD, 60 * SECOND)
    assert np.degrees(plant.state[0, 2]) == pytest.approx(stable, abs=0.005)
    assert "captured" in {event.kind for event in events}
    assert plant.support_changes < 2000


def test_within_an_interval_of_no_torque_the_large_parcel_stays_as_it_is() -> None:
    plant = Plant(_scene(LARGE, np.radians(178.0)))
    before = plant.state
    plant.advance(plant.array.positions_m * FIELD, 20 * SECOND)
    assert plant.state == pytest.approx(before, abs=1e-12)
