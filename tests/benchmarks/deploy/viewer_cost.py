"""What a viewer costs a running simulation.

``python tests/benchmarks/deploy/viewer_cost.py`` measures and prints its method.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from heat_run import rate_of, running

from deploy.live.client import LiveRun

METHOD = """\
Method. mdms run heat on {cells:,} cells, packed, recorded, as fast as possible. Turns of {seconds:g} s without a viewer
alternate with turns beside a viewer: a process that asks for {rate:g} frames a second and discards each; or such a
process that is stopped (SIGSTOP) for the whole turn while a request may be under way; or beside nobody, which shows
what the machine's own changes make of the ratio. "ratio" is the median over
{turns} pairs of ticks/s with the viewer by ticks/s without, beside the least and the greatest. Client, run and workers
share the cores.
"""


LEAST = 0.95
"""Least ratio in the median, beside a viewer that looks and beside one that is stopped."""
_ATTACH_S = 2.0
"""Time in which a viewer attaches, s."""


def view(connect: str, rate: float) -> None:
    """Ask for frames and discard each, until killed."""
    with LiveRun(connect) as run:
        while True:
            begun = time.monotonic()
            run.frame()
            time.sleep(max(1.0 / rate - (time.monotonic() - begun), 0.0))


@contextmanager
def viewer(connect: str, rate: float, name: str) -> Iterator[None]:
    """Have a viewer look inside the context, or be stopped; or ``nobody``."""
    if name == "nobody":
        time.sleep(_ATTACH_S)
        yield
        return
    process = subprocess.Popen([sys.executable, __file__, "--view", connect, "--rate", str(rate)])
    try:
        time.sleep(_ATTACH_S)
        if name == "stopped":
            os.kill(process.pid, signal.SIGSTOP)
        yield
    finally:
        process.kill()
        process.wait()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=10_000, help="number of cells")
    parser.add_argument("--turns", type=int, default=5, help="pairs of turns")
    parser.add_argument("--seconds", type=float, default=5.0, help="length of a turn")
    parser.add_argument("--rate", type=float, default=10.0, help="frames a second")
    parser.add_argument("--check", action="store_true", help=f"fail if a viewer leaves less than {LEAST:g}")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--view", metavar="ENDPOINT", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.view:
        view(options.view, options.rate)
    found: dict[str, list[float]] = {"looking": [], "stopped": [], "nobody": []}
    with running(options.cells) as (run, _):
        rate_of(run, options.seconds)
        alone = [rate_of(run, options.seconds)]
        for _ in range(options.turns):
            for name, ratios in found.items():
                with viewer(run.connect, options.rate, name):
                    beside = rate_of(run, options.seconds)
                alone.append(rate_of(run, options.seconds))
                ratios.append(beside / statistics.mean(alone[-2:]))
    rows = {
        name: {"ratio": statistics.median(ratios), "least": min(ratios), "greatest": max(ratios)}
        for name, ratios in found.items()
    }
    slow = [name for name, row in rows.items() if name != "nobody" and row["ratio"] < LEAST]
    if options.json:
        print(json.dumps({"alone_ticks_per_s": statistics.median(alone), **rows}))
    else:
        print_rows(options, alone, rows)
    if options.check and slow:
        raise SystemExit(f"the run is too slow beside: {', '.join(slow)}")


def print_rows(options: argparse.Namespace, alone: list[float], rows: dict[str, dict[str, float]]) -> None:
    """Print the method and the figures."""
    print(METHOD.format(cells=options.cells, seconds=options.seconds, rate=options.rate, turns=options.turns))
    print(f"without a viewer: {statistics.median(alone):,.0f} ticks/s")
    for name, row in rows.items():
        bound = "" if name == "nobody" else f"  must be >= {LEAST:g}"
        print(f"{name:10} ratio {row['ratio']:.3f}  ({row['least']:.3f} .. {row['greatest']:.3f}){bound}")


if __name__ == "__main__":
    main()
