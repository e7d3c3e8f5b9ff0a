"""Events beyond the room of a kernel's log are counted, whichever solver had them and however the call was cut."""

from __future__ import annotations

import numpy as np
import pytest

from plant.kernels.common.parcels import LOG_CAPACITY
from plant.observations import Event
from plant.plant import Plant
from plant.sampling import Timing
from tests.plant.scenes import SECOND, parcel, solved

PITCH_M = 0.02
SPEED_M_S = 0.5
DURATION_NS = 4 * SECOND
CALLS = 16


def _plant(solver: str) -> Plant:
    """A parcel that glides over 100 columns with its wheels, on and off 25 cells at each."""
    gliding = parcel(
        size_m=(0.5, 0.5), position_m=(-1.0, 0.003), angle_rad=0.0, velocity_m_s=(SPEED_M_S, 0.0)
    )
    return solved({"name": solver}, gliding, rows=30, columns=130, pitch_m=PITCH_M)


def _drives(plant: Plant) -> np.ndarray:
    return np.tile([SPEED_M_S, 0.0], (len(plant.array), 1))


def _gone(plant: Plant, calls: int, *, timed: bool = False) -> list[Event]:
    cells = len(plant.array)
    _, events = plant.advance(_drives(plant), SECOND // 1000)  # the wheels run from here on
    for call in range(1, calls + 1):
        # Wheels that are set again in the middle: the call goes in legs.
        timing = Timing(np.full(cells, DURATION_NS // 2), np.full(cells, DURATION_NS))
        _, happened = plant.advance(_drives(plant), DURATION_NS * call // calls, timing if timed else None)
        events = [*events, *happened]
    return events


@pytest.mark.parametrize("solver", ["exact", "fixed_step"])
def test_events_that_one_call_has_no_room_for_are_counted(solver: str) -> None:
    short, long = _plant(solver), _plant(solver)
    every = _gone(short, CALLS)
    assert (short.events_left_out, len(every)) == (0, short.support_changes)
    listed = _gone(long, 1)
    assert LOG_CAPACITY <= len(listed) < len(every)
    assert long.events_left_out == long.support_changes - len(listed) > 0
    assert abs(long.support_changes - short.support_changes) < 0.02 * short.support_changes


def test_events_of_a_call_in_legs_are_counted_though_each_leg_has_room_for_its_own() -> None:
    plant = _plant("exact")
    listed = _gone(plant, 1, timed=True)
    assert plant.support_changes < 2 * LOG_CAPACITY
    assert LOG_CAPACITY <= len(listed) < plant.support_changes
    assert plant.events_left_out == plant.support_changes - len(listed)
    assert [event.time_s for event in listed] == sorted(event.time_s for event in listed)


def test_the_number_is_remembered() -> None:
    from bus.state import load_state, save_state

    plant, again = _plant("exact"), _plant("exact")
    _gone(plant, 1)
    load_state(again, save_state(plant))
    assert again.events_left_out == plant.events_left_out > 0
