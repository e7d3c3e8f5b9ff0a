"""Shards that are built once, before their processes are forked.

A process that builds its shard touches much of what its parent imported: Python counts references in the objects, and
each page with a touched object is copied.
"""

from __future__ import annotations

import asyncio
import threading
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Final

import numpy as np

from bus.lockstep import Coordinator
from bus.transports.event_loop import TransportEventLoop
from bus.transports.memory import MemoryBus
from bus.wire.frames import Control, SenseFrame
from cell_firmware import agent
from cell_firmware.loader import BUNDLED
from deploy.workers.overrun import Watchdog
from deploy.workers.worker import (
    BuiltShard,
    WorkerConfig,
    build_shard,
    cell_faults,
    make_controller,
    open_participant,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from bus.sensors import SensorSchema

_FEW: Final = 4
"""Cells of a shard that is built here. Larger shards take longer, and their processes build them side by side."""

_PAUSE_S: Final = 0.0005

_STAND_IN: Final = "max_consensus"
"""Bundled program that is exercised instead of a user's: its cells talk, and it needs no parameters."""


def share_shards(order: WorkerConfig) -> Callable[[int], None]:
    """Build the shards of all workers, and return their order with them.

    Programs of users run in their cells' processes alone, so that their shards are built there.

    Raises:
        FirmwareError: The firmware refuses its parameters.
    """
    shards = order.partition.count
    few = len(order.array) <= _FEW * shards
    if order.scene.cells.firmware not in BUNDLED:
        if few:
            _exercise(_with_stand_in(order))
        return order
    if not few:
        make_controller(order.scene, cell_faults(order.scene))  # imports the effects
        return order
    _exercise(order)
    return partial(_work, order, [build_shard(order, shard) for shard in range(shards)])


def _with_stand_in(order: WorkerConfig) -> WorkerConfig:
    """Return the order with another program, whose cells have the same boards."""
    cells = order.scene.cells.model_copy(update={"firmware": _STAND_IN, "parameters": {}})
    return replace(order, scene=order.scene.model_copy(update={"cells": cells}))


def _work(order: WorkerConfig, built: Sequence[BuiltShard], shard: int) -> None:
    order(shard, built[shard])


def _exercise(order: WorkerConfig) -> None:
    """Run a shard for a tick without its process: what fills caches is shared by the processes."""
    bus, built = MemoryBus(), build_shard(order, 0)
    shard = built.cells
    endpoint = bus.endpoint()
    host = Coordinator(
        bus.endpoint(),
        order.partition,
        order.wire,
        run=order.run,
        readings=order.sensors,
        message=shard.message,
        wanted=order.register_requests,
        stall=order.scene.stall,
        keeps=order.snapshots,
    )
    member = open_participant(order, 0, endpoint, shard)
    if shard.message is None or order.wire == "relayed":  # else neighbours would have to subscribe first
        member.ready()
    host.publish(_at_rest(len(order.array), order.sensors))

    over = threading.Event()

    def stop() -> None:
        while shard.tick < 0 and not over.wait(_PAUSE_S):
            pass
        host.control(Control("stop", 1))

    # a thread of its own: a timer of the loop would keep the agent from waiting for payloads alone
    stopper = threading.Thread(target=stop, name="stop", daemon=True)
    stopper.start()
    inject = agent.injector(shard, built.site, order.partition.lattice)
    watched = partial(Watchdog, order.scene.stall.deadline_s, "stall.deadline_s")
    try:
        with asyncio.Runner(loop_factory=partial(TransportEventLoop, endpoint)) as runner:
            runner.run(agent.run(shard, member, inject, built.records, watched=watched))
    finally:
        over.set()
        stopper.join()
    host.close()  # first: the participant waits for it
    member.close()


def _at_rest(cells: int, sensors: SensorSchema) -> SenseFrame:
    """Return the senses of cells under which nothing moves, of tick 0."""
    return SenseFrame(
        0,
        np.zeros((cells, sensors.sensors), dtype=np.bool_),
        np.zeros((cells, 2)) if sensors.encoders else None,
        np.zeros((cells, sensors.sensors)) if sensors.levels else None,
        np.zeros(cells, dtype=np.int64) if sensors.labels else None,
    )
