from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.firmware import Cells, Inbox, Inputs
from cell_firmware.protocols.presence_field import PresenceField, PresenceFieldParameters


def waking(reach: int) -> PresenceField:
    field = {"kind": "uniform", "velocity_m_s": [0.2, -0.1]}
    return PresenceField(PresenceFieldParameters.model_validate({"field": field, "reach": reach}))


def steps_apart(lattice: Lattice, cell: tuple[int, int]) -> np.ndarray:
    """Links from a cell to every other, holes gone round."""
    apart = np.full(len(lattice), 10**6)
    waiting = [lattice.index(cell)]
    apart[waiting[0]] = 0
    for i in waiting:
        for j in lattice.neighbours[i]:
            if j >= 0 and apart[j] == 10**6:
                apart[j] = apart[i] + 1
                waiting.append(int(j))
    return apart


@pytest.mark.parametrize("reach", [0, 1, 3])
def test_wheels_run_as_far_from_a_sensed_parcel_as_the_word_has_come(
    grid: Callable[..., Lattice], run: Callable[..., Any], reach: int
) -> None:
    lattice = grid(5, 6, missing=[(2, 3)])
    apart = steps_apart(lattice, (2, 2))
    presence = np.zeros((6, len(lattice), 1), dtype=np.bool_)
    presence[:, lattice.index((2, 2))] = True
    drives = run(waking(reach), Partition.even(lattice, 3), 6, presence=presence).drives
    for tick, drive in enumerate(drives):
        awake = apart <= min(tick, reach)
        assert np.array_equal(drive, np.where(awake[:, None], [0.2, -0.1], 0.0))


def test_the_field_falls_asleep_when_the_parcel_is_gone(
    grid: Callable[..., Lattice], run: Callable[..., Any]
) -> None:
    lattice = grid(4, 4)
    presence = np.zeros((9, len(lattice), 1), dtype=np.bool_)
    presence[:5, 5] = True
    drives = run(waking(2), Partition.even(lattice, 1), 9, presence=presence).drives
    assert [bool(np.any(drive)) for drive in drives] == [True] * 7 + [False] * 2


def test_any_of_a_cell_s_sensors_wakes_it() -> None:
    firmware: Any = waking(0)

    lattice = Lattice([(0, 0), (0, 1)])
    cells = Cells.of(lattice, np.zeros((2, 2)), 0.004, ((0.0, 0.0), (0.01, 0.0)))
    inbox = Inbox(np.zeros((2, 4), dtype=np.bool_), np.zeros((2, 4), dtype=firmware.message))
    _, outputs = firmware.step(
        firmware.init(cells), Inputs(np.array([[False, True], [False, False]]), None, inbox)
    )
    assert outputs.speed_m_s.tolist() == [[0.2, -0.1], [0.0, 0.0]]


def test_a_word_counts_for_as_many_periods_as_the_cell_has_patience(grid: Callable[..., Lattice]) -> None:
    def awake(ttl_periods: int) -> list[bool]:
        """Of a cell that receives one message, and then none."""
        field = {"kind": "uniform", "velocity_m_s": [1.0, 0.0]}
        firmware = PresenceField(
            PresenceFieldParameters.model_validate({"field": field, "ttl_periods": ttl_periods})
        )
        state = firmware.init(Cells.of(grid(1, 1), np.zeros((1, 2)), 0.004))
        found: list[bool] = []
        for tick in range(6):
            inbox = Inbox(np.zeros((1, 4), dtype=np.bool_), np.zeros((1, 4), dtype=firmware.message))
            if tick == 1:
                inbox.received[0, 2], inbox.message["level"][0, 2] = True, 2
            state, outputs = firmware.step(state, Inputs(np.zeros((1, 1), dtype=np.bool_), None, inbox))
            found.append(bool(outputs.speed_m_s[0, 0]))
        return found

    assert awake(1) == [False, True, False, False, False, False]
    assert awake(3) == [False, True, True, True, False, False]
