"""Drives that act later: which one acts in a tick, and which are void."""

from __future__ import annotations

import numpy as np

from bus.lockstep.counters import Loss
from bus.state import load_state, save_state
from plant.delayed_drives import DelayedDrives

TICKS = 3


def _drives(tick: int) -> np.ndarray:
    return np.full((2, 2), float(tick + 1))


def _acting(delayed: DelayedDrives, tick: int) -> list[float]:
    """The first wheel's drive of both cells in a tick, whose senses were answered in that tick."""
    delayed.put(_drives(tick), ())
    return delayed.take(tick)[0][:, 0].tolist()


def test_a_drive_acts_so_many_ticks_after_its_senses_and_wheels_begin_with_zero() -> None:
    delayed = DelayedDrives(2, TICKS)
    assert [_acting(delayed, tick)[0] for tick in range(7)] == [0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0]


def test_what_a_cell_computed_before_and_during_its_death_is_void_after_its_repair() -> None:
    delayed = DelayedDrives(2, TICKS)
    acted: list[list[float]] = []
    for tick in range(10):
        if tick in (4, 5):  # shorter than the delay
            delayed.mark_dead(np.array([True, False]), tick)
        acted.append(_acting(delayed, tick))
    # the other cell's drives act all the time; the drive of tick 6, the first after the repair, acts in tick 9
    assert [two for _, two in acted] == [0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0]
    assert [one for one, _ in acted] == [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 7.0]


def test_a_loss_is_due_when_the_missing_drive_would_have_acted() -> None:
    delayed, loss = DelayedDrives(2, TICKS), Loss(1, 2, "disconnected", "")
    due: list[int] = []
    for tick in range(7):
        delayed.put(_drives(tick), (loss,) if tick == 2 else ())
        if delayed.take(tick)[1]:
            due.append(tick)
    assert due == [5]


def test_instants_are_as_late_as_the_drives() -> None:
    delayed = DelayedDrives(2, 2)
    found = [delayed.delay_instants(np.array([10 * tick, -1]), 100).tolist() for tick in range(4)]
    assert found == [[-1, -1], [-1, -1], [200, -1], [210, -1]]


def test_what_is_in_flight_is_part_of_the_state() -> None:
    one, other = DelayedDrives(2, TICKS), DelayedDrives(2, TICKS)
    for tick in range(5):
        _acting(one, tick)
    one.put(_drives(5), (Loss(0, 5, "failed", "why"),))
    one.mark_dead(np.array([False, True]), 3)
    load_state(other, save_state(one))
    assert other.in_flight == one.in_flight == [Loss(0, 5, "failed", "why")]
    for tick in range(5, 8):
        assert other.take(tick)[0].tolist() == one.take(tick)[0].tolist()
