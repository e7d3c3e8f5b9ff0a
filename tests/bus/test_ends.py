"""The end of a run, or of one side of it; being woken."""

from __future__ import annotations

import threading

import pytest

from bus.errors import CoordinatorLostError, WaitInterrupted
from bus.lockstep import Participant
from bus.partition import Partition
from bus.sensors import SensorSchema
from tests.bus.support import (
    SENSORS,
    FakeClock,
    Network,
    System,
    grid,
    step,
)


def test_a_member_notices_that_the_plant_is_gone(network: Network) -> None:
    system = System(network, Partition.each(grid(1, 1)), "packed").start()
    step(system, 0)
    system.host.close()
    with pytest.raises(CoordinatorLostError, match="waited for tick 1"):
        system.members[0].gather(1)


def test_a_member_with_a_limit_gives_up_a_silent_plant(memory: Network) -> None:
    clock = FakeClock()
    system = System(memory, Partition.each(grid(1, 1)), "packed", clock=clock)
    member = Participant(
        system.member_endpoints[0], system.partition, 0, "packed",
        run="test", readings=SensorSchema(SENSORS), message=None, silence_s=4.0, clock=clock,
    )  # fmt: skip
    with pytest.raises(CoordinatorLostError, match="silent for 4 s; shard 0 waited for tick 0"):
        member.gather(0)


def test_wake_ends_a_gather_on_either_side_and_it_may_be_repeated(network: Network) -> None:
    system = System(network, Partition.each(grid(1, 1)), "packed").start()
    for endpoint, gather in (
        (system.member_endpoints[0], system.members[0].gather),
        (system.endpoint, system.host.gather),
    ):
        waker = threading.Timer(0.02, endpoint.wake)
        waker.start()
        with pytest.raises(WaitInterrupted):
            gather(0)
        waker.join()
    assert step(system, 0)[1] == []
