"""The bare side of ``fast.py``: plain Zenoh code that exchanges payloads of given sizes and reads none of them."""

from __future__ import annotations

import multiprocessing
import time
from dataclasses import dataclass

import numpy as np
import zenoh
from zenoh import handlers

from bus.partition import Partition
from bus.sensors import SensorSchema
from bus.transports.zenoh import open_client, open_hub
from bus.wire.format import RunSchema
from bus.wire.formats import FORMATS, WireFormat
from bus.wire.frames import DriveFrame, LinkFrame, SenseFrame

CAPACITY = 4096
LATE_TICK = 100_000
"""Tick whose payloads are as long as those of nearly all ticks."""


@dataclass(frozen=True)
class Exchange:
    """Sizes of the payloads of a tick, bytes.

    Attributes:
        senses: From the plant, one a worker.
        drives: To the plant, one a worker.
        links: Between workers: sender, receiver and size of each.
    """

    senses: tuple[int, ...]
    drives: tuple[int, ...]
    links: tuple[tuple[int, int, int], ...]

    @property
    def bytes_a_tick(self) -> int:
        """Bytes of all payloads."""
        return sum(self.senses) + sum(self.drives) + sum(size for _, _, size in self.links)

    @classmethod
    def of(
        cls, partition: Partition, form: WireFormat, readings: SensorSchema, message: np.dtype | None
    ) -> Exchange:
        """Return the payloads of a run whose units are its shards."""
        schema = RunSchema("bare", partition, readings, message)
        n, shards = len(partition.lattice), range(partition.count)
        frame = SenseFrame(
            LATE_TICK,
            np.zeros((n, readings.sensors), dtype=np.bool_),
            np.zeros((n, 2)) if readings.encoders else None,
        )
        senses = FORMATS[form].coordinator(schema).sense_payloads(frame)
        drives, links = list[int](), list[tuple[int, int, int]]()
        for shard in shards:
            side = FORMATS[form].participant(schema, shard)
            out = len(partition.outgoing(shard))
            sent = None
            if schema.message is not None:
                sent = LinkFrame(LATE_TICK, np.ones(out, dtype=np.bool_), np.zeros(out, schema.message))
                targets = [int(partition.shard_of[cells[0]]) for cells in side.out_targets]
                payloads = side.link_payloads(sent)
                links += [(shard, to, len(text)) for to, text in zip(targets, payloads, strict=True)]
            drive = DriveFrame(LATE_TICK, np.zeros((len(partition.cells(shard)), 2)))
            (payload,) = side.drive_payloads(drive, sent)
            drives.append(len(payload))
        return cls(tuple(map(len, senses)), tuple(drives), tuple(links))


class BareExchange:
    """The plant's side, and a process a worker."""

    def __init__(self, exchange: Exchange) -> None:
        self._hub = open_hub()
        session = self._hub.session
        self._payloads = [bytes(size) for size in exchange.senses]
        self._drives = session.declare_subscriber("bare/drive/*", handlers.FifoChannel(CAPACITY))
        context = multiprocessing.get_context("forkserver")
        context.set_forkserver_preload(["fast_bare"])
        self._workers = [
            context.Process(target=_work, args=(exchange, worker, self._hub.locator), daemon=True)
            for worker in range(len(exchange.senses))
        ]
        for worker in self._workers:
            worker.start()
        self.pids = [worker.pid for worker in self._workers if worker.pid is not None]
        self._senses = [_publisher(session, f"bare/sense/{i}") for i in range(len(self._payloads))]
        while not all(publisher.matching_status.matching for publisher in self._senses):
            time.sleep(0.01)

    def tick(self) -> None:
        """Put all senses, and receive all drives."""
        for publisher, payload in zip(self._senses, self._payloads, strict=True):
            publisher.put(payload)
        for _ in self._payloads:
            self._drives.recv().payload.to_bytes()

    def close(self) -> None:
        """End the workers."""
        for worker in self._workers:
            worker.kill()
            worker.join()
        self._hub.close()


def _publisher(session: zenoh.Session, key: str) -> zenoh.Publisher:
    """Puts as the lockstep does: blocking, reliable, batched."""
    return session.declare_publisher(
        key, congestion_control=zenoh.CongestionControl.BLOCK, reliability=zenoh.Reliability.RELIABLE
    )


def _work(exchange: Exchange, worker: int, locator: str) -> None:
    """Wait for the senses and for what other workers sent in the tick before, and answer."""
    session = open_client(locator).session
    out = [(to, size) for sender, to, size in exchange.links if sender == worker]
    links_in = sum(to == worker for _, to, _ in exchange.links)
    heard = session.declare_subscriber(f"bare/link/*/{worker}", handlers.FifoChannel(CAPACITY))
    links = [(_publisher(session, f"bare/link/{worker}/{to}"), bytes(size)) for to, size in out]
    drive, payload = _publisher(session, f"bare/drive/{worker}"), bytes(exchange.drives[worker])
    while not all(publisher.matching_status.matching for publisher in (drive, *(put for put, _ in links))):
        time.sleep(0.01)
    sense = session.declare_subscriber(f"bare/sense/{worker}", handlers.FifoChannel(CAPACITY))
    first = True
    while True:
        sense.recv().payload.to_bytes()
        for _ in range(0 if first else links_in):
            heard.recv().payload.to_bytes()
        first = False
        for publisher, message in links:
            publisher.put(message)
        drive.put(payload)
