"""A router with keys passes on what fits the layout of its keys, and nothing larger."""

from __future__ import annotations

import time
from pathlib import Path

import zenoh

from bus.partition import Partition
from bus.transports.base import Received
from bus.transports.zenoh import open_client, open_router
from bus.transports.zenoh.endpoint import free_port
from deploy.scenes.files import load_scene
from deploy.security.generate import generate_keys
from deploy.security.keyring import Keyring, identity_of
from deploy.security.roles import ProcessLayout


def test_payloads_above_the_limits_of_a_role_end_at_the_router_and_are_counted(tmp_path: Path) -> None:
    lattice = load_scene("motors").lattice()
    cut = ProcessLayout(Partition.even(lattice, 2), "packed", ("cells 0", "cells 1"))
    generate_keys(tmp_path / "keys", "motors", cut, "password", hosts=(), days=1, force=False)
    keyring, endpoint = Keyring(tmp_path / "keys"), f"tcp/127.0.0.1:{free_port()}"
    router = open_router([endpoint], keyring.router_gate())
    plant = open_client(endpoint, identity=keyring.plant_as_client())
    cells = open_client(endpoint, identity=identity_of(tmp_path / "keys" / "cells-0", "cells-0"))
    try:
        assert router.refusals is not None
        key = "mdms/run/shard/0/drive"
        plant.subscribe(key)
        put = cells.publisher(key)
        while not put.matched():
            time.sleep(0.01)
        for payload in (b"before", bytes(100_000), bytes(10_000_000), b"after"):
            cells.session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
        received = [plant.receive(5.0) for _ in range(2)]
        assert [one.payload for one in received if isinstance(one, Received)] == [b"before", b"after"]
        deadline = time.monotonic() + 5.0
        while sum(router.refusals.counted().values()) < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
        assert sum(router.refusals.counted().values()) == 2
    finally:
        for session in (cells, plant, router):
            session.close()
