"""How long ``mdms run elliptic --duration 0.01`` takes from shell to prompt, with everything compiled.

``python tests/benchmarks/deploy/warm_start.py`` measures and prints its method, beside bare imports for scale.
"""

from __future__ import annotations

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[3]

METHOD = """\
Method. Each command is a process of its own, timed from its start to its end; medians of {repeat}, after one run
that is not counted. The run has the plant here, one worker process, Zenoh between them, a recording, a summary and a
picture."""


def _seconds(command: list[str], repeat: int) -> tuple[float, str]:
    times: list[float] = []
    stdout = ""
    for _ in range(repeat + 1):
        begun = time.perf_counter()
        done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
        times.append(time.perf_counter() - begun)
        stdout = done.stdout
    return statistics.median(times[1:]), stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=5)
    repeat = parser.parse_args().repeat
    print(METHOD.format(repeat=repeat))
    mdms = [sys.executable, "-m", "deploy.cli"]
    with tempfile.TemporaryDirectory() as folder:
        run = [*mdms, "run", "elliptic", "--duration", "0.01", "--output", folder, "--json"]
        whole, stdout = _seconds(run, repeat)
        bare, _ = _seconds([*run, "--no-picture"], repeat)
        imports, _ = _seconds([sys.executable, "-c", "import numpy, scipy, zenoh"], repeat)
        usage, _ = _seconds([*mdms, "--help"], repeat)
    summary = json.loads(stdout)
    print(
        f"mdms run elliptic --duration 0.01    {whole:.2f} s, of which start-up {summary['startup_s']:.2f} s"
    )
    print(f"the same with --no-picture           {bare:.2f} s")
    print(f"mdms --help                          {usage:.2f} s")
    print(
        f"python -c 'import numpy, scipy, zenoh'  {imports:.2f} s; the run takes {whole / imports:.1f} times that"
    )


if __name__ == "__main__":
    main()
