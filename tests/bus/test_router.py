"""A router between plant and cells, which a run does not need: what its death and its return are to them."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

import numpy as np
import pytest

from bus.errors import CoordinatorLostError
from bus.lockstep import Coordinator, Participant
from bus.partition import Partition
from bus.transports.base import Received
from bus.transports.zenoh import open_client
from bus.transports.zenoh.endpoint import free_port
from bus.wire.frames import SenseFrame
from tests.bus.support import PRESENCE, SENSORS, gathered, grid

_ROUTER = """
import sys, zenoh
config = zenoh.Config()
for key, value in (("mode", '"router"'), ("listen/endpoints", f'["{sys.argv[1]}"]'),
                   ("scouting/multicast/enabled", "false"), ("scouting/gossip/enabled", "false"),
                   ("transport/unicast/qos/enabled", "false")):
    config.insert_json5(key, value)
session = zenoh.open(config)
print("listens", flush=True)
sys.stdin.read()
"""


@contextmanager
def _router(locator: str) -> Iterator[subprocess.Popen[bytes]]:
    """One that listens there, until killed."""
    with subprocess.Popen(
        [sys.executable, "-c", _ROUTER, locator], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        try:
            assert process.stdout.readline() == b"listens\n"
            yield process
        finally:
            process.kill()


def test_a_router_that_dies_loses_all_cells_by_name_at_once_and_sessions_are_back_when_it_is() -> None:
    locator, two = f"tcp/127.0.0.1:{free_port()}", Partition.even(grid(1, 2), 1)
    sense = SenseFrame(0, np.ones((2, SENSORS), dtype=np.bool_), None)
    with _router(locator) as router:
        plant, cells = open_client(locator), open_client(locator)
        host = Coordinator(plant, two, "packed", run="test", readings=PRESENCE, message=None)
        member = Participant(cells, two, 0, "packed", run="test", readings=PRESENCE, message=None)
        ready = Thread(target=member.ready, args=(10.0,))
        ready.start()
        host.barrier(10.0)
        ready.join()
        host.publish(sense)
        gathered(member.gather(0))
        router.kill()
        killed = time.monotonic()
        _, losses = host.gather(0)
        assert time.monotonic() - killed < 1.0
        assert [(loss.cell, loss.tick, loss.reason) for loss in losses] == [
            (0, 0, "disconnected"),
            (1, 0, "disconnected"),
        ]
        with pytest.raises(CoordinatorLostError, match="the plant left"):
            member.gather(1)
    with _router(locator):
        cells.subscribe("again")
        put, deadline = plant.publisher("again").put, time.monotonic() + 20.0
        arrived = False
        while not arrived and time.monotonic() < deadline:
            put(b"word")
            arrived = Received("again", b"word") in cells.receive_all(0.2)
        assert arrived
        plant.close()
        cells.close()
    assert not host.live(1).any()
