"""The start of a run: who is waited for, and who is named when it fails."""

from __future__ import annotations

import pytest

from bus.errors import BarrierError, CoordinatorLostError, WaitInterrupted
from bus.partition import Partition
from bus.wire.formats import WireFormat
from tests.bus.support import (
    MESSAGE,
    FakeClock,
    Network,
    System,
    every_format,
    expected_drive,
    grid,
    step,
)


@every_format
def test_the_barrier_names_who_never_appeared_and_who_is_not_ready(memory: Network, form: WireFormat) -> None:
    clock = FakeClock()
    system = System(memory, Partition.each(grid(1, 3)), form, clock=clock, message=MESSAGE)
    system.member_endpoints[1].declare_alive(
        "mdms/test/cell/0/1/alive" if form == "per_cell" else "mdms/test/shard/1/alive"
    )
    system.members[2].ready(5.0)  # its one neighbour subscribed, although it is not ready
    with pytest.raises(BarrierError) as caught:
        system.host.barrier(7.0)
    assert caught.value.absent == ((0, 0),)
    assert caught.value.unready == ((0, 1),)
    assert str(caught.value) == (
        "not every cell is ready after 7 s; never appeared: 1 cell (0,0); appeared but not ready: 1 cell (0,1)"
    )


def test_the_barrier_names_who_left_again_and_counts_the_many(memory: Network) -> None:
    clock = FakeClock()
    system = System(memory, Partition.even(grid(4, 5), 2), "packed", clock=clock)
    system.members[0].ready(5.0)
    system.members[0].close()
    with pytest.raises(BarrierError) as caught:
        system.host.barrier()
    said = str(caught.value)
    assert "never appeared: 10 cells (2,0 2,1 2,2 2,3 2,4 3,0 3,1 3,2 3,3 3,4)" in said
    assert "appeared and left again: 10 cells" in said
    assert len(caught.value.absent) == 20


def test_a_participant_without_connections_names_the_expected_peers(memory: Network) -> None:
    clock = FakeClock()
    partition = Partition.each(grid(1, 2))
    system = System(memory, partition, "per_cell", clock=clock, message=MESSAGE)
    system.member_endpoints[1].close()
    with pytest.raises(BarrierError, match=r"no subscriber for mdms/test/cell/0/0/to/east"):
        system.members[0].ready(1.0)


def test_a_member_without_a_plant_says_so(memory: Network) -> None:
    clock = FakeClock()
    system = System(memory, Partition.each(grid(1, 1)), "packed", clock=clock)
    system.endpoint.close()
    member = system.members[0]
    with pytest.raises((BarrierError, CoordinatorLostError), match="plant"):
        member.ready(1.0)


@every_format
def test_a_run_starts_in_any_order_on_any_transport(network: Network, form: WireFormat) -> None:
    system = System(network, Partition.even(grid(2, 3), 3), form, message=MESSAGE).start()
    drive, losses = step(system, 0)
    assert losses == []
    assert drive.drive.tolist() == expected_drive(system, 0).tolist()


def test_waking_the_barrier_ends_it(memory: Network) -> None:
    system = System(memory, Partition.each(grid(1, 2)), "packed")
    system.endpoint.wake()
    with pytest.raises(WaitInterrupted):
        system.host.barrier()
