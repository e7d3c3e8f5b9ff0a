"""Arrays that go into the plant and come out of it are nobody's way to change it behind its back."""

from __future__ import annotations

import numpy as np
import pytest

from plant.effects.motors import MotorsSpec
from plant.plant import Plant
from tests.plant.scenes import TICK_NS, parcel, spec

MOTORS = [None, MotorsSpec()]
IDS = ["ideal", "motors"]


@pytest.mark.parametrize("motors", MOTORS, ids=IDS)
def test_drives_that_the_caller_changes_afterwards_change_no_wheel(motors: MotorsSpec | None) -> None:
    plant = Plant(spec(parcel(), motors=motors))
    drives = np.full((len(plant.array), 2), 0.3)
    plant.advance(drives, TICK_NS)
    before = plant.wheel_speed.copy()
    drives[:] = 7.0
    assert np.array_equal(plant.wheel_speed, before)
    assert np.all(before != 0.0)


@pytest.mark.parametrize("motors", MOTORS, ids=IDS)
def test_what_the_plant_shows_of_its_wheels_is_read_only(motors: MotorsSpec | None) -> None:
    plant = Plant(spec(parcel(), motors=motors))
    sense, _ = plant.advance(np.full((len(plant.array), 2), 0.3), TICK_NS)
    shown = [plant.wheel_speed] if motors is None else [plant.wheel_speed, sense.encoder_m]
    for array in shown:
        assert array is not None
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 7.0


@pytest.mark.parametrize("motors", MOTORS, ids=IDS)
def test_drives_may_be_read_only_and_move_the_same(motors: MotorsSpec | None) -> None:
    ends: list[bytes] = []
    for writeable in (True, False):
        plant = Plant(spec(parcel(), motors=motors))
        drives = 0.1 * plant.array.positions_m
        drives.setflags(write=writeable)
        plant.advance(drives, TICK_NS)
        ends.append(plant.state.tobytes() + plant.wheel_speed.tobytes())
    assert ends[0] == ends[1]
