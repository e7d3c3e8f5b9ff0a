"""What the two sides of ``lockstep.py`` have in common: the case that they run, and their worker processes."""

from __future__ import annotations

import multiprocessing
from abc import ABC, abstractmethod
from dataclasses import dataclass
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess

import numpy as np

from bus.lattice import Lattice
from bus.partition import Partition
from bus.sensors import SensorSchema
from bus.wire.format import RunSchema
from bus.wire.formats import WireFormat

MESSAGE = np.dtype([("u", "<f8")])
RUN = "benchmark"
SENSORS = 1


@dataclass(frozen=True)
class Case:
    """One exchange to measure, in turns of ``ticks``; ``target`` is the least ratio, None where it is only printed."""

    title: str
    rows: int
    columns: int
    workers: int
    form: WireFormat
    ticks: int
    target: float | None

    def partition(self) -> Partition:
        lattice = Lattice((r, c) for r in range(self.rows) for c in range(self.columns))
        return Partition.even(lattice, self.workers)

    def wiring(self) -> RunSchema:
        return RunSchema(RUN, self.partition(), SensorSchema(SENSORS, encoders=True), MESSAGE)


@dataclass(frozen=True)
class Worker:
    """A worker process, and where it says what it spent."""

    process: BaseProcess
    says: Connection

    def spent_s(self) -> float:
        """Processor seconds that it spent in ticks, once it has ended."""
        if not self.says.poll(10.0):
            raise SystemExit(f"worker {self.process.pid} does not end")
        spent: float = self.says.recv()
        self.process.join(10.0)
        return spent


class Side(ABC):
    """One way to run a case: the plant's side in this process, the workers in their own."""

    workers: list[Worker]

    @abstractmethod
    def tick(self, k: int) -> None:
        """Senses out, drives in."""

    @abstractmethod
    def stop(self) -> None:
        """Tells the workers to end; they say what processor time they spent in ticks."""

    @abstractmethod
    def close(self) -> None:
        """Closes the plant's session, once the workers have ended."""


def start_workers(side: str, case: Case, locator: str) -> list[Worker]:
    """A process a shard, forked from a server that has the modules and no session, as real workers are."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["lockstep_workers"])
    workers: list[Worker] = []
    for shard in range(case.workers):
        says, tell = context.Pipe(duplex=False)
        process = context.Process(target=_work, args=(side, case, shard, locator, tell), daemon=True)
        process.start()
        tell.close()
        workers.append(Worker(process, says))
    return workers


def _work(side: str, case: Case, shard: int, locator: str, tell: Connection) -> None:
    from lockstep_workers import WORKERS  # in the child, where it is imported already

    tell.send(WORKERS[side](case, shard, locator))
