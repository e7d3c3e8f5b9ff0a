"""The bundled scenes show what their titles say."""

from __future__ import annotations

from math import pi

import pytest

from deploy.scene_files import load_scene
from deploy.simulate import field_speeds
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
