"""When the processes of lost cells are started anew."""

from __future__ import annotations

from typing import Any, cast

import pytest

from bus.lattice import Lattice
from bus.lockstep.counters import Loss, Reason
from bus.partition import Partition
from deploy.workers.respawn import Respawner

PARTITION = Partition.even(Lattice((0, column) for column in range(4)), 2)


class Processes:
    """Workers and a host that only keep books."""

    def __init__(self, most: int) -> None:
        self.restarted: list[int] = []
        self.over: set[int] = set()
        self.back: list[int] = []
        self.asked: list[int] = []
        self.warned: list[str] = []
        self.respawn = Respawner(self, cast("Any", self), PARTITION, most, self.warned.append)

    def restart(self, shard: int) -> None:
        self.restarted.append(shard)

    def ended(self, shard: int) -> bool:
        return shard in self.over

    def admit(self, tick: int) -> list[int]:
        """Of the host."""
        self.asked.append(tick)
        return self.back

    def lose(self, *cells: int, reason: Reason = "disconnected") -> None:
        self.respawn.on_lost([Loss(cell, 5, reason) for cell in cells])


def test_a_process_is_started_once_however_many_of_its_cells_were_lost() -> None:
    processes = Processes(9)
    processes.lose(1, 0)
    processes.lose(3, reason="timed_out")
    assert processes.restarted == [0, 1]
    assert processes.warned == [
        "the process of shard 0 is restarted (1 of 9)",
        "the process of shard 1 is restarted (2 of 9)",
    ]


def test_a_program_that_failed_fails_again_and_is_not_started() -> None:
    processes = Processes(9)
    processes.lose(0, reason="failed")
    assert processes.restarted == []
    assert processes.respawn.poll_rejoined(6) == processes.asked == []


def test_who_took_part_again_and_is_lost_once_more_is_started_once_more() -> None:
    processes = Processes(9)
    processes.lose(0, 2)
    processes.back = [0, 1]
    assert processes.respawn.poll_rejoined(7) == [0, 1]
    processes.lose(3, 1)
    assert processes.restarted == [0, 1, 0]
    processes.back = [0, 1, 2, 3]
    assert processes.respawn.poll_rejoined(8) == [0, 1, 2, 3]
    assert processes.respawn.poll_rejoined(9) == []
    assert processes.asked == [7, 8]


@pytest.mark.parametrize("most", [0, 2])
def test_a_process_that_ends_before_it_takes_part_is_started_as_often_as_is_allowed(most: int) -> None:
    processes = Processes(most)
    processes.over = {1}
    processes.lose(2)
    for tick in range(6, 9):
        assert processes.respawn.poll_rejoined(tick) == []
    assert processes.restarted == [1] * most
    assert processes.warned[most:] == [
        f"the process of shard 1 is not restarted: the limit is {most} (--respawn)"
    ]
