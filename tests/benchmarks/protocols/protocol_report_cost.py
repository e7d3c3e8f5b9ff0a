"""What it costs to watch a protocol: processor time of the same run without a report and with one.

``python tests/benchmarks/protocols/protocol_report_cost.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions

SIZES = ((3, 6), (10, 20), (25, 40), (100, 100))
SHORT = 20
"""Ticks of the run that is taken off."""
METHOD = """\
Method. heat_diffusion (diffusion number 0.2, one corner warm) without parcels, everything in one process over Zenoh.
Processor time of all threads a tick: of a run of {ticks} ticks less that of one of {short}. The median of {repeats}
rounds, in each of which the run goes without a report, with one, and with --protocol-report 10.
"""


def scene(rows: int, columns: int, ticks: int) -> Scene:
    """A bare array that conducts heat."""
    warm = [{"cell": [0, 0], "speed_m_s": [0.3, 0.0]}]
    values = {
        "duration_s": round(ticks * 0.004096, 6),
        "array.rows": rows,
        "array.columns": columns,
        "parcels": [],
        "cells.parameters": {"diffusion_number": 0.2, "initial": warm},
    }
    return load_scene("heat", [Override(tuple(key.split(".")), value, "") for key, value in values.items()])


def processor_s(what: Scene, every: int | None) -> float:
    """Processor time of one run and its cells, of all threads."""
    with tempfile.TemporaryDirectory() as folder:
        options = RunOptions(processes=0, output=Path(folder), picture=False, protocol_report=every)
        begun = time.process_time()
        run(what, options, quiet=True)
        return time.process_time() - begun


def a_tick_s(rows: int, columns: int, ticks: int, every: int | None) -> float:
    """Processor time of a tick: that of a long run beyond that of a short one, which starts and ends alike."""
    long, short = (processor_s(scene(rows, columns, number), every) for number in (ticks, SHORT))
    return (long - short) / (ticks - SHORT)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--ticks", type=int, default=420)
    parser.add_argument(
        "--sizes", type=int, default=len(SIZES), help="so many sizes of array, from the smallest"
    )
    asked = parser.parse_args()
    print(METHOD.format(ticks=asked.ticks, short=SHORT, repeats=asked.repeats))
    print(f"{'cells':>7}{'plain':>10}{'reported':>10}{'ratio':>8}{'every 10':>10}{'ratio':>8}   ms a tick")
    for rows, columns in SIZES[: asked.sizes]:
        rounds = [
            tuple(a_tick_s(rows, columns, asked.ticks, every) for every in (None, 1, 10))
            for _ in range(asked.repeats)
        ]
        plain, each, tenth = (1e3 * median(one[i] for one in rounds) for i in range(3))
        print(
            f"{rows * columns:7,}{plain:10.2f}{each:10.2f}{each / plain:8.2f}{tenth:10.2f}{tenth / plain:8.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main()
