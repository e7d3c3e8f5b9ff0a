"""What the two sides of ``lockstep.py`` have in common: the case that they run, and their worker processes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from bus.forms import FormName
from bus.forms.form import Wiring
from bus.lattice import Lattice
from bus.partition import Partition

MESSAGE = np.dtype([("u", "<f8")])
RUN = "benchmark"
SENSORS = 1
_WORKER = Path(__file__).with_name("lockstep.py")


@dataclass(frozen=True)
class Case:
    """One exchange to measure, in turns of ``ticks``; ``target`` is the least ratio, None where it is only printed."""

    title: str
    rows: int
    columns: int
    workers: int
    form: FormName
    ticks: int
    target: float | None

    def partition(self) -> Partition:
        lattice = Lattice((r, c) for r in range(self.rows) for c in range(self.columns))
        return Partition.even(lattice, self.workers)

    def wiring(self) -> Wiring:
        return Wiring(RUN, self.partition(), SENSORS, True, MESSAGE)


class Side(ABC):
    """One way to run a case: the plant's side in this process, the workers in their own."""

    workers: list[subprocess.Popen[str]]

    @abstractmethod
    def tick(self, k: int) -> None:
        """Senses out, drives in."""

    @abstractmethod
    def stop(self) -> None:
        """Tells the workers to end; they print the processor seconds that they spent in ticks."""

    @abstractmethod
    def close(self) -> None:
        """Closes the plant's session, once the workers have ended."""


def start_workers(side: str, case: Case, locator: str) -> list[subprocess.Popen[str]]:
    """A process a shard, from a command line: nothing is inherited."""
    order = json.dumps({"side": side, "case": asdict(case), "locator": locator})
    return [
        subprocess.Popen(
            [sys.executable, str(_WORKER), "--worker", order, "--shard", str(shard)],
            stdout=subprocess.PIPE,
            text=True,
            # real workers are forked, and a fork has none of these threads
            env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
        )
        for shard in range(case.workers)
    ]
