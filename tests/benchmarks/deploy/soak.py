"""Whether the memory of a run grows.

``python tests/benchmarks/deploy/soak.py`` measures and prints its method.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import numpy as np
from heat_run import running
from process_memory import descendants, megabytes

METHOD = """\
Method. mdms run heat on {cells:,} cells, packed, recorded to disk, as fast as possible. Memory is the PSS of all of its
processes together, every {every:g} s. "begins" is the median of the second tenth of the samples, "ends" that of the
last tenth; the slope is that of a line fitted through all but the first tenth.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cells", type=int, default=1024, help="number of cells, a square")
    parser.add_argument("--minutes", type=float, default=10.0, help="length of the run")
    parser.add_argument("--every", type=float, default=5.0, help="seconds between samples")
    options = parser.parse_args()
    print(METHOD.format(cells=options.cells, every=options.every))
    ticks: list[int] = []
    memory: list[float] = []
    with running(options.cells) as (run, pid):
        end = time.monotonic() + 60.0 * options.minutes
        while time.monotonic() < end or len(memory) < 20:
            time.sleep(min(options.every, 6.0 * options.minutes))
            ticks.append(run.status()["tick"])
            memory.append(sum(megabytes(each, "Pss") for each in [pid, *descendants(pid)]))
    tenth = len(memory) // 10
    begins, ends = np.median(memory[tenth : 2 * tenth]), np.median(memory[-tenth:])
    slope = np.polyfit(ticks[tenth:], memory[tenth:], 1)[0]
    print(
        f"{ticks[-1]:,} ticks in {options.minutes:g} min; memory begins {begins:.1f} MB, ends {ends:.1f} MB,"
    )
    print(f"largest {max(memory):.1f} MB, slope {1e6 * slope:.2f} MB per million ticks")


if __name__ == "__main__":
    main()
