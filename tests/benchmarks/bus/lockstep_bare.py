"""The bare side of ``lockstep.py``: a plain Zenoh program that exchanges as many payloads of the same sizes."""

from __future__ import annotations

import queue
import time

import numpy as np
import zenoh
from lockstep_case import SENSORS, Case, Side, start_workers
from zenoh import handlers

from bus.transports.zenoh import open_hub
from bus.wire.formats import FORMATS
from bus.wire.frames import SenseFrame

CAPACITY = 4096


def bare_publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """Puts as the lockstep does: blocking, reliable, batched."""
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.BLOCK,
        reliability=zenoh.Reliability.RELIABLE,
    )


class Bare(Side):
    """The plant's side: puts all senses, receives all drives."""

    def __init__(self, case: Case) -> None:
        form = FORMATS[case.form].coordinator(case.wiring())
        cells = len(case.partition().lattice)
        presence, encoder_m = np.zeros((cells, SENSORS), dtype=np.bool_), np.full((cells, 2), 0.1)
        self._senses = form.sense_payloads(SenseFrame(1000, presence, encoder_m))
        self._hub = open_hub()
        session = self._hub.session
        ready: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
        self._drives = session.declare_subscriber("bare/drive/*/*", handlers.FifoChannel(CAPACITY))
        watch = session.liveliness().declare_subscriber(
            "bare/ready/*", handlers.Callback(ready.put, indirect=False), history=True
        )
        shard_of = case.partition().shard_of
        self._puts = [
            bare_publisher(session, f"bare/{shard_of[unit_cells[0]]}/sense/{i}")
            for i, unit_cells in enumerate(form.unit_cells)
        ]
        self._stop = bare_publisher(session, "bare/stop")
        self.workers = start_workers("bare", case, self._hub.locator)
        for _ in self.workers:
            ready.get(timeout=30)
        watch.undeclare()
        while not all(p.matching_status.matching for p in self._puts):
            time.sleep(0.01)

    def tick(self, k: int) -> None:
        for publisher, payload in zip(self._puts, self._senses, strict=True):
            publisher.put(payload)
        for _ in self._senses:
            self._drives.recv().payload.to_bytes()

    def stop(self) -> None:
        self._stop.put(b"")
        # They look for it once they have ended a tick.
        for publisher, payload in zip(self._puts, self._senses, strict=True):
            publisher.put(payload)

    def close(self) -> None:
        self._hub.close()
