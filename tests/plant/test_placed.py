"""A parcel put elsewhere between two calls: it goes on as if it had started there."""

from __future__ import annotations

import numpy as np
import pytest

from deploy.runs.setup import load_plant
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from plant.errors import PlantError
from plant.plant import Plant

SPAN_NS = 4_096_000
POSE = np.array([0.31, 0.27, 0.4])


def plant(scene: str = "elliptic", *overrides: Override) -> Plant:
    return load_plant(load_scene(scene, overrides), lambda _: None)


def drives(of: Plant) -> np.ndarray:
    return -np.sign(of.array.positions_m) * 0.3


@pytest.mark.parametrize("solver", ["exact", "implicit"])
def test_a_parcel_goes_on_from_where_it_was_put(solver: str) -> None:
    moved = plant("elliptic", Override(("solver", "name"), solver, ""))
    for k in range(1, 20):
        moved.advance(drives(moved), k * SPAN_NS)
    moved.place_parcel(0, POSE)
    np.testing.assert_array_equal(moved.state, [[*POSE, 0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(moved.last_readings.presence, moved.sense().presence)
    fresh = plant(
        "elliptic",
        Override(("solver", "name"), solver, ""),
        Override(("parcels", 0, "position_m"), POSE[:2].tolist(), ""),
        Override(("parcels", 0, "angle_rad"), float(POSE[2]), ""),
        Override(("parcels", 0, "velocity_m_s"), [0.0, 0.0], ""),
        Override(("parcels", 0, "angular_velocity_rad_s"), 0.0, ""),
    )
    for k in range(1, 40):
        moved.advance(drives(moved), (19 + k) * SPAN_NS)
        fresh.advance(drives(fresh), k * SPAN_NS)
    np.testing.assert_allclose(moved.state, fresh.state, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("pose", "why"), [((30.0, 0.0, 0.0), "stands on nothing"), ((0.999, 0.999, 0.0), "tip|nothing")]
)
def test_a_parcel_that_can_t_stand_there_stays_where_it_is(
    pose: tuple[float, float, float], why: str
) -> None:
    one, other = plant(), plant()
    one.advance(drives(one), SPAN_NS)
    other.advance(drives(other), SPAN_NS)
    with pytest.raises(PlantError, match=why):
        one.place_parcel(0, np.array(pose))
    one.advance(drives(one), 2 * SPAN_NS)
    other.advance(drives(other), 2 * SPAN_NS)
    np.testing.assert_array_equal(one.state, other.state)


def test_a_parcel_is_not_put_on_another() -> None:
    several = plant("carousel")
    place = several.state[1, :3]
    with pytest.raises(PlantError, match="parcel 0 would overlap parcel 1"):
        several.place_parcel(0, place)
    with pytest.raises(PlantError, match="parcel 99 is not on the surface"):
        several.place_parcel(99, place)


def test_a_parcel_at_rest_or_tipped_moves_again() -> None:
    one = plant("elliptic")
    still = np.zeros((len(one.array), 2))
    for k in range(1, 3_000):
        one.advance(still, k * SPAN_NS)
        if one.status[0].state == "at_rest":
            break
    else:
        pytest.fail("never at rest")
    one.place_parcel(0, POSE)
    assert one.status[0].state == "moving"
    one.advance(drives(one), one.time_ns + 20 * SPAN_NS)
    assert np.hypot(*one.state[0, 3:5]) > 1e-3
