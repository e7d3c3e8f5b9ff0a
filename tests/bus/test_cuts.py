"""A link between plant and cells is cut: for less than the lease nothing is lost, for more the cells are."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack

import numpy as np
import pytest

from bus.errors import CoordinatorLostError
from bus.lockstep import Coordinator, Participant
from bus.partition import Partition
from bus.spec import StallSpec
from bus.transports.zenoh import open_client, open_hub
from bus.wire.frames import DriveFrame, SenseFrame
from tests.bus.cut_link import CutLink
from tests.bus.support import PRESENCE, SENSORS, gathered, grid

Pair = tuple[Coordinator, Participant, CutLink]
TWO = Partition.even(grid(1, 2), 1)


@pytest.fixture
def apart() -> Iterator[Callable[[float], Pair]]:
    """Makes a plant and two cells with this lease, started, and the link between them."""
    with ExitStack() as stack:

        def start(lease_s: float) -> Pair:
            hub = open_hub(lease_s=lease_s)
            stack.callback(hub.close)
            link = stack.enter_context(CutLink(hub.locator))
            cells = open_client(link.locator, lease_s=lease_s)
            stack.callback(cells.close)
            stall = StallSpec(deadline_s=20.0, lease_s=lease_s)
            host = Coordinator(hub, TWO, "packed", run="test", readings=PRESENCE, message=None, stall=stall)
            member = Participant(
                cells, TWO, 0, "packed", run="test", readings=PRESENCE, message=None, stall=stall
            )
            member.ready(10.0)
            host.barrier(10.0)
            return host, member, link

        yield start


def _sense(tick: int) -> SenseFrame:
    return SenseFrame(tick, np.ones((2, SENSORS), dtype=np.bool_), None)


def test_a_cut_shorter_than_the_lease_costs_its_time_and_nothing_else(apart: Callable[[float], Pair]) -> None:
    host, member, link = apart(2.0)
    for tick in range(6):
        if tick == 3:
            link.cut_for(0.4)
            cut = time.monotonic()
        host.publish(_sense(tick))
        gathered(member.gather(tick))
        member.publish(DriveFrame(tick, np.full((2, 2), float(tick))), None)
        drive, losses = host.gather(tick)
        assert (drive.drive.tolist(), losses) == ([[tick, tick]] * 2, [])
    assert time.monotonic() - cut >= 0.4
    assert (host.counters.lost, host.counters.late, member.counters.lost, member.counters.late) == (
        0,
        0,
        0,
        0,
    )


def test_a_cut_longer_than_the_lease_loses_the_cells_behind_it_by_name(
    apart: Callable[[float], Pair],
) -> None:
    host, member, link = apart(0.3)
    link.cut_for(1.5)
    cut = time.monotonic()
    host.publish(_sense(0))
    drive, losses = host.gather(0)
    assert time.monotonic() - cut < 1.2
    assert [(loss.cell, loss.tick, loss.reason) for loss in losses] == [
        (0, 0, "disconnected"),
        (1, 0, "disconnected"),
    ]
    assert not drive.drive.any()
    with pytest.raises(CoordinatorLostError, match="the plant left"):
        member.gather(1)
