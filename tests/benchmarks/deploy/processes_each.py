"""What a tick costs where every cell has a process of its own, by wire format.

``python tests/benchmarks/deploy/processes_each.py`` runs a scene with real cells in each wire format and prints its
method.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))
# the server that forks the workers knows no other way to find their modules
os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)

from bus.wire.formats import FORMATS
from bus.wire.keys import WireFormat
from deploy.runs.backends import Workers
from deploy.runs.simulation import Simulation
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override

METHOD = """\
Method. The scene {scene} with {processes} processes of cells, which compute what they compute in mdms run, in every
wire format at the same time; the runs take turns of {ticks} ticks, each first in as many rounds, so that what else the
machine does meets all alike. "us a tick" is processor time of all threads (schedstat) in a form's turns: of all
processes, of a process of cells, and of the plant's process. The ratios are medians over {turns} rounds, to per_cell in
the same round. The tests compare the digests.
"""


def _of_threads(pid: int, name: str) -> Iterator[str]:
    """Yield a file of every thread of a process; threads that end meanwhile have none."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):
            yield (task / name).read_text()


def _descendants(pid: int) -> Iterator[int]:
    for children in _of_threads(pid, "children"):
        for child in map(int, children.split()):
            yield child
            yield from _descendants(child)


def _spent_us(pid: int) -> float:
    """Processor time of all threads of a process."""
    return sum(int(stat.split()[0]) for stat in _of_threads(pid, "schedstat")) / 1e3


@dataclass
class Run:
    """One run and what its turns took.

    Attributes:
        simulation: The run.
        pids: Its processes but the plant's: those of its cells, and the server that forked them.
        cells: Number of its processes of cells.
        rates: Ticks a second in each turn.
        workers_us: Processor time a tick in each turn, of the processes of cells together.
        plant_us: Processor time a tick in each turn, of the plant's process.
    """

    simulation: Simulation
    pids: list[int]
    cells: int
    rates: list[float] = field(default_factory=list[float])
    workers_us: list[float] = field(default_factory=list[float])
    plant_us: list[float] = field(default_factory=list[float])

    def take_turn(self, ticks: int) -> None:
        """Run so many ticks."""
        workers, plant, start = self._workers_us(), _spent_us(os.getpid()), time.perf_counter()
        for _ in range(ticks):
            if self.simulation.step() is None:
                raise SystemExit(f"the run is over: {self.simulation.result}")
        self.rates.append(ticks / (time.perf_counter() - start))
        self.workers_us.append((self._workers_us() - workers) / ticks)
        self.plant_us.append((_spent_us(os.getpid()) - plant) / ticks)

    def _workers_us(self) -> float:
        return sum(map(_spent_us, self.pids))

    @property
    def total_us(self) -> list[float]:
        """Processor time a tick in each turn, of all processes."""
        return [cells + plant for cells, plant in zip(self.workers_us, self.plant_us, strict=True)]


def measure(scene: str, forms: list[WireFormat], processes: int | None, ticks: int, turns: int) -> Any:
    """Figures of every form."""
    loaded = load_scene(scene, [Override(("duration_s",), 1e4, "--duration")])
    runs: dict[str, Run] = {}
    with ExitStack() as stack:
        for form in forms:
            before = set(_descendants(os.getpid()))
            workers = Workers(processes or "each", form)
            simulation = stack.enter_context(Simulation.open(loaded, workers))
            pids = sorted(set(_descendants(os.getpid())) - before)
            runs[form] = Run(simulation, pids, processes or len(simulation.plant.array))
            runs[form].take_turn(ticks)  # to warm up
            for taken in (runs[form].rates, runs[form].workers_us, runs[form].plant_us):
                taken.clear()
        for turn in range(turns):
            first = turn % len(forms)
            for form in (*forms[first:], *forms[:first]):
                runs[form].take_turn(ticks)
    base = runs.get("per_cell", runs[forms[0]])
    return {
        "scene": scene,
        "processes": runs[forms[0]].cells,
        "forms": {
            form: {
                "ticks_per_s": statistics.median(run.rates),
                "us_a_tick": statistics.median(run.total_us),
                "us_a_process": statistics.median(run.workers_us) / run.cells,
                "us_of_the_plant": statistics.median(run.plant_us),
                "rate_ratio": statistics.median(
                    ours / theirs for ours, theirs in zip(run.rates, base.rates, strict=True)
                ),
                "time_ratio": statistics.median(
                    ours / theirs for ours, theirs in zip(run.total_us, base.total_us, strict=True)
                ),
            }
            for form, run in runs.items()
        },
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", default="prototype")
    parser.add_argument("--form", action="append", choices=list(FORMATS), help="only this form; repeatable")
    parser.add_argument("--processes", type=int, help="processes of cells; default: one a cell")
    parser.add_argument("--ticks", type=int, default=50, help="ticks of a turn")
    parser.add_argument("--turns", type=int, default=12, help="turns of each form")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    options = parser.parse_args()
    forms: list[WireFormat] = options.form or list(FORMATS)
    found = measure(options.scene, forms, options.processes, options.ticks, options.turns)
    if options.json:
        print(json.dumps(found))
        return
    print(
        METHOD.format(
            scene=options.scene, processes=found["processes"], ticks=options.ticks, turns=options.turns
        )
    )
    heads = ("ticks/s", "us a tick", "a process", "plant", "rate", "time")
    print(f"{'form':10}" + "".join(f"{head:>11}" for head in heads))
    for form, row in found["forms"].items():
        numbers = [
            *(f"{row[name]:11.0f}" for name in list(row)[:4]),
            *(f"{row[name]:11.2f}" for name in list(row)[4:]),
        ]
        print(f"{form:10}" + "".join(numbers))


if __name__ == "__main__":
    main()
