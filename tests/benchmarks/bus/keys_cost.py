"""What keys cost: a run with certificates, with passwords, and without either.

``python tests/benchmarks/bus/keys_cost.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import resource
import statistics
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from keys_case import Run, keys_for, run_once, write_scene

from deploy.workers.plan import Processes

CELLS = 18

METHOD = """\
Method. heat_diffusion on 3 x 6 cells in {processes} processes, a parcel between them, by mdms run, in turns, the median
of {turns}. "ticks/s": of {ticks} ticks, without start-up. "processor": time of all processes together, a tick: of
{ticks} ticks less that of {few}. "certificates": mutual TLS, access control by role, what is refused counted.
"passwords": the same by user and password over TCP. All must come to the same digest.
"""


@dataclass(frozen=True)
class Cost:
    """Of one turn."""

    ticks_per_s: float
    processor_ms: float
    digest: str


def main() -> None:
    """Prints the figures."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--ticks", type=int, default=1_500)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--processes", type=int, default=CELLS, help="of cells")
    given = parser.parse_args()
    few = given.ticks // 10
    print(METHOD.format(processes=given.processes, ticks=given.ticks, turns=given.turns, few=few))
    processes: Processes = "each" if given.processes == CELLS else given.processes
    with tempfile.TemporaryDirectory() as folder:
        measure(Path(folder), processes, given.ticks, few, given.turns)


def measure(folder: Path, processes: Processes, ticks: int, few: int, turns: int) -> None:
    """Runs every way in turns."""
    scene = write_scene(folder)
    ways = {
        "plain": None,
        "certificates": keys_for(scene, processes, folder / "certificates", "certificate"),
        "passwords": keys_for(scene, processes, folder / "passwords", "password"),
    }
    found: dict[str, list[Cost]] = {name: [] for name in ways}
    for _ in range(turns):
        for name, keys in ways.items():
            found[name].append(cost(Run(scene, processes, keys, folder / "out"), ticks, few))
    if len({one.digest for costs in found.values() for one in costs}) != 1:
        raise SystemExit("the digests differ")
    rate = {name: statistics.median(one.ticks_per_s for one in costs) for name, costs in found.items()}
    spent = {name: statistics.median(one.processor_ms for one in costs) for name, costs in found.items()}
    for name in ways:
        print(
            f"{name:14} {rate[name]:6,.0f} ticks/s, {rate[name] / rate['plain']:.2f} of plain;   "
            f"processor {spent[name]:5.2f} ms a tick, {spent[name] / spent['plain']:.2f} of plain"
        )


def cost(run: Run, ticks: int, few: int) -> Cost:
    """Of a run, its start-up taken away."""
    before = _spent_s()
    run_once(run, few)
    between = _spent_s()
    summary = run_once(run, ticks)
    both = _spent_s()
    more_s = (both - between) - (between - before)
    return Cost(summary["ticks_per_s"], 1e3 * more_s / (ticks - few), summary["digest"])


def _spent_s() -> float:
    """Processor time of all processes that were started and have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


if __name__ == "__main__":
    main()
