"""A worker of a campaign: runs one scene after another, and tells how each ended."""

from __future__ import annotations

import socket
import threading
import traceback
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import TYPE_CHECKING, final

from deploy.campaign.ending import Ending, ending_of

if TYPE_CHECKING:
    from deploy.scene import Scene

PRELOAD = (
    "asyncio",
    "msgpack",
    "numpy",
    "bus.lockstep",
    "bus.transports.memory",
    "cell_firmware.agent",
    "cell_firmware.assembly",
    "deploy.campaign.worker",
    "deploy.effect_study.course",
    "plant.kernels.block",
    "plant.plant",
    "plant.process",
)
"""What a worker needs: imported once, before the workers are forked. Importing kernels neither compiles
nor runs one."""

_CELLS = "cells"
"""Name of the thread in which a run's cells are."""


@final
@dataclass(frozen=True, slots=True)
class Work:
    """What a worker does until nobody hands it anything more.

    Args:
        address: Path of the socket on which scenes are handed out.
    """

    address: str

    def __call__(self, worker: int) -> None:
        """Run scenes; ``worker`` is this one's number."""
        line = socket.socket(socket.AF_UNIX)
        line.connect(self.address)
        with Connection(line.detach()) as desk:
            desk.send(worker)
            while True:
                try:
                    scene: Scene = desk.recv()
                except (EOFError, ConnectionResetError):
                    return
                ending = _run(scene)
                # A firmware that never returns would slow down what runs here next: another process does that.
                spent = any(thread.name == _CELLS for thread in threading.enumerate())
                desk.send((ending, spent))
                if spent:
                    return


def _run(scene: Scene) -> Ending:
    try:
        return ending_of(scene)
    except Exception as error:  # noqa: BLE001 - whatever it is, it is how this run ended, and the others go on
        where = traceback.extract_tb(error.__traceback__)[-1]
        return Ending(status="failed", reason=f"{error!r} ({where.filename}, line {where.lineno})")
