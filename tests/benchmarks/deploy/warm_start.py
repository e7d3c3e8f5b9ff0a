"""How long ``mdms run elliptic --duration 0.01`` takes from shell to prompt, with everything compiled.

``python tests/benchmarks/deploy/warm_start.py`` measures and prints its method, beside bare imports for scale.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[3]

METHOD = """\
Method. Each command is a process of its own, timed from its start to its end; medians of {repeat}, after one run
that is not counted. Processor time is of it and its processes. The run has the plant here, one worker process, Zenoh
between them, a recording, a summary and a picture, which a process of its own draws. Python keeps its bytecode, even
where PYTHONDONTWRITEBYTECODE is set."""


class Taken(NamedTuple):
    """Wall time and processor time of a command, s."""

    wall: float
    processor: float

    def __str__(self) -> str:
        return f"{self.wall:.2f} s, processor time {self.processor:.2f} s"


def _environment(bytecode: str) -> dict[str, str]:
    """Return this process's environment, with a folder for Python's bytecode, which else might never be kept."""
    kept = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    return {**kept, "PYTHONPYCACHEPREFIX": bytecode}


def _timed(command: list[str], repeat: int, environment: dict[str, str]) -> tuple[Taken, str]:
    walls: list[float] = []
    processors: list[float] = []
    stdout = ""
    for _ in range(repeat + 1):
        begun, before = time.perf_counter(), os.times()
        done = subprocess.run(command, cwd=ROOT, env=environment, check=True, capture_output=True, text=True)
        walls.append(time.perf_counter() - begun)
        after = os.times()
        processors.append(
            after.children_user + after.children_system - before.children_user - before.children_system
        )
        stdout = done.stdout
    return Taken(statistics.median(walls[1:]), statistics.median(processors[1:])), stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=5)
    repeat = parser.parse_args().repeat
    print(METHOD.format(repeat=repeat))
    mdms = [sys.executable, "-m", "deploy.cli"]
    with tempfile.TemporaryDirectory() as folder, tempfile.TemporaryDirectory() as bytecode:
        environment = _environment(bytecode)
        run = [*mdms, "run", "elliptic", "--duration", "0.01", "--output", folder, "--json"]
        whole, stdout = _timed(run, repeat, environment)
        bare, _ = _timed([*run, "--no-picture"], repeat, environment)
        imports, _ = _timed([sys.executable, "-c", "import numpy, scipy, zenoh"], repeat, environment)
        usage, _ = _timed([*mdms, "--help"], repeat, environment)
    summary = json.loads(stdout)
    print(f"mdms run elliptic --duration 0.01       {whole}; start-up {summary['startup_s']:.2f} s")
    print(f"the same with --no-picture              {bare}")
    print(f"mdms --help                             {usage}")
    print(f"python -c 'import numpy, scipy, zenoh'  {imports}")
    print(f"load while this ran: {os.getloadavg()[0]:.1f} on {os.cpu_count()} processors")


if __name__ == "__main__":
    main()
