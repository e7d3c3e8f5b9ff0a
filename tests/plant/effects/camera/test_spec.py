"""The camera: when pictures are taken and shown, what is on them, and how noise is drawn."""

from __future__ import annotations

from fractions import Fraction
from math import ceil, pi

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from bus.sensors import CameraFrame
from plant.effects.camera.camera import Camera
from plant.effects.camera.spec import CameraSpec
from plant.effects.registry import PlantEffects
from plant.factories import make_camera

TICK_NS = 4_096_000
ALL = np.arange(3)


def state(tick: int) -> np.ndarray:
    """With its tick encoded."""
    return np.arange(18.0).reshape(3, 6) * 0.01 + 0.1 * tick


def film(spec: CameraSpec, ticks: int, seed: int = 1, later: int = 0) -> dict[int, CameraFrame]:
    camera = Camera(spec, TICK_NS, seed, later)
    shown = {tick: camera.capture(tick, state(tick), ALL) for tick in range(ticks)}
    return {tick: picture for tick, picture in shown.items() if picture is not None}


@given(period_us=st.integers(500, 60_000), latency_us=st.integers(0, 60_000), later=st.integers(0, 1))
def test_pictures_are_taken_and_shown_at_the_first_ticks_that_are_not_too_early(
    period_us: int, latency_us: int, later: int
) -> None:
    period_s, latency_s = period_us / 1e6, latency_us / 1e6
    found = film(CameraSpec(period_s=period_s, latency_s=latency_s), 60, later=later)
    tick_us = Fraction(TICK_NS, 1000)
    taken = sorted({ceil(j * period_us / tick_us) for j in range(1 + int(60 * tick_us) // period_us)})
    expected = [t + ceil(latency_us / tick_us) + later for t in taken]
    assert list(found) == [tick for tick in expected if tick < 60]
    for shown, then in zip(found, taken, strict=False):
        assert found[shown].pose[:, :2].tolist() == state(then)[:, :2].tolist()


def test_angles_lie_within_a_turn() -> None:
    poses = np.zeros((5, 6))
    poses[:, 2] = [pi, -pi, 3.0 * pi + 0.5, -20.0, 1e-300]
    picture = Camera(CameraSpec(), TICK_NS, 1).capture(0, poses, np.arange(5))
    assert picture is not None
    angle = picture.pose[:, 2]
    assert ((angle >= -pi) & (angle < pi)).all()
    np.testing.assert_allclose(np.exp(1j * angle), np.exp(1j * poses[:, 2]), atol=1e-14)


def test_who_is_not_there_is_not_seen_and_changes_nothing_for_the_others() -> None:
    spec = CameraSpec(period_s=0.004, position_noise_m=0.01, angle_noise_rad=0.02)
    some, every = Camera(spec, TICK_NS, 1), Camera(spec, TICK_NS, 1)
    for tick in range(3):
        here = np.array([0, 2]) if tick else ALL[:0]
        one, other = some.capture(tick, state(tick), here), every.capture(tick, state(tick), ALL)
        assert one is not None
        assert other is not None
        assert one.parcel.tolist() == here.tolist()
        assert one.pose.tobytes() == other.pose[here].tobytes()


def test_noise_has_its_size_and_is_the_seeds() -> None:
    spec = CameraSpec(period_s=0.001, position_noise_m=0.01, angle_noise_rad=0.05)
    found = film(spec, 2000)
    off = np.array([picture.pose - state(tick)[:, :3] for tick, picture in found.items()])
    off[:, :, 2] = np.angle(np.exp(1j * off[:, :, 2]))
    for axis, sigma in enumerate((0.01, 0.01, 0.05)):
        # the sample's standard deviation is off by sigma / sqrt(2 n), its mean by sigma / sqrt(n)
        assert abs(off[:, :, axis].std() / sigma - 1.0) < 4.0 / 12000**0.5
        assert abs(off[:, :, axis].mean() / sigma) < 4.0 / 6000**0.5
    again, another = film(spec, 3), film(spec, 3, seed=2)
    assert again[2].pose.tobytes() == found[2].pose.tobytes() != another[2].pose.tobytes()


def test_a_scene_without_a_camera_has_none_and_a_period_of_0_is_refused() -> None:
    assert make_camera(PlantEffects(), TICK_NS, 1) is None
    with pytest.raises(ValidationError):
        CameraSpec(period_s=0.0)
