"""The bare side of ``lockstep.py``: a plain Zenoh program that exchanges as many payloads of the same sizes."""

from __future__ import annotations

import queue
import time

import numpy as np
import zenoh
from lockstep_case import MESSAGE, SENSORS, Case, Side, start_workers
from zenoh import handlers

from bus.forms import FORMS
from bus.transports.zenoh import open_client, open_hub
from bus.wire import DriveFrame, LinkFrame, SenseFrame

_CAPACITY = 4096


def _publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    return session.declare_publisher(
        key,
        congestion_control=zenoh.CongestionControl.BLOCK,
        reliability=zenoh.Reliability.RELIABLE,
    )


def bare_worker(case: Case, shard: int, locator: str) -> None:
    """Waits for a sense a unit and a payload a link that comes in; answers with as many as the form has."""
    form = FORMS[case.form].member(case.wiring(), shard)
    endpoint = open_client(locator)
    session = endpoint.session
    rows, links = len(case.partition().cells(shard)), len(case.partition().outgoing(shard))
    drives = form.drive_payloads(DriveFrame(1000, np.full((rows, 2), 0.1)))
    frame = LinkFrame(1000, np.ones(links, dtype=np.bool_), np.full(links, 0.1).view(MESSAGE))
    messages = form.link_payloads(frame)
    sense = session.declare_subscriber(f"bare/{shard}/sense/*", handlers.FifoChannel(_CAPACITY))
    heard = session.declare_subscriber(f"bare/{shard}/link/*/*", handlers.FifoChannel(_CAPACITY))
    stop = session.declare_subscriber("bare/stop", handlers.FifoChannel(1))
    drive_puts = [_publisher(session, f"bare/drive/{shard}/{i}") for i in range(len(drives))]
    shard_of = case.partition().shard_of
    link_puts = [
        _publisher(session, f"bare/{shard_of[targets[0]]}/link/{shard}/{i}")
        for i, targets in enumerate(form.out_targets)
    ]
    while not all(p.matching_status.matching for p in (*drive_puts, *link_puts)):
        time.sleep(0.01)
    token = session.liveliness().declare_token(f"bare/ready/{shard}")
    links_in, first = len(form.in_parts), True
    spent = time.process_time()
    while stop.try_recv() is None:
        for _ in drives:
            sense.recv().payload.to_bytes()
        for _ in range(0 if first else links_in):
            heard.recv().payload.to_bytes()
        first = False
        for publisher, payload in zip(link_puts, messages, strict=True):
            publisher.put(payload)
        for publisher, payload in zip(drive_puts, drives, strict=True):
            publisher.put(payload)
    print(time.process_time() - spent)
    del token
    endpoint.close()


class Bare(Side):
    """The plant's side: puts all senses, receives all drives."""

    def __init__(self, case: Case) -> None:
        form = FORMS[case.form].host(case.wiring())
        cells = len(case.partition().lattice)
        presence, encoder_m = np.zeros((cells, SENSORS), dtype=np.bool_), np.full((cells, 2), 0.1)
        self._senses = form.sense_payloads(SenseFrame(1000, presence, encoder_m))
        self._hub = open_hub()
        session = self._hub.session
        ready: queue.SimpleQueue[zenoh.Sample] = queue.SimpleQueue()
        self._drives = session.declare_subscriber("bare/drive/*/*", handlers.FifoChannel(_CAPACITY))
        watch = session.liveliness().declare_subscriber(
            "bare/ready/*", handlers.Callback(ready.put, indirect=False), history=True
        )
        shard_of = case.partition().shard_of
        self._puts = [
            _publisher(session, f"bare/{shard_of[unit_cells[0]]}/sense/{i}")
            for i, unit_cells in enumerate(form.unit_cells)
        ]
        self._stop = _publisher(session, "bare/stop")
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
