"""Random schedules of real process faults: 18 cells, one a process, are killed and stopped, and the plant is stopped.

``python tests/benchmarks/deploy/process_faults.py --schedules 500`` prints how the runs ended and all that did not
hold. After
each: it ended well or as its stall policy says; no process is left; the recording can be read and has every tick once;
with the losses injected as faults, in one process over memory, the digest is the same.
"""

from __future__ import annotations

import argparse
import faulthandler
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.system.schedules import Schedule, Verdict, carry_out

LONGEST_S = 90.0
"""Wall time after which a run counts as hanging: where every thread stands is printed, and all ends."""


def verdict(seed: int) -> Verdict:
    """What came of a seed's schedule."""
    faulthandler.dump_traceback_later(LONGEST_S, exit=True)
    with tempfile.TemporaryDirectory() as folder:
        found = carry_out(Schedule.drawn(seed), Path(folder))
    faulthandler.cancel_dump_traceback_later()
    for line in found.wrong:
        print(f"seed {seed}: {line}", flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--schedules", type=int, default=500)
    parser.add_argument("--first", type=int, default=0, help="seed of the first schedule")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        carry_out(Schedule(0, "coast", 0, ()), Path(folder))  # kernels are compiled
    begun = time.monotonic()
    ended, lost, back, wrong = Counter[str](), 0, 0, 0
    for seed in range(asked.first, asked.first + asked.schedules):
        found = verdict(seed)
        ended[found.status] += 1
        lost, back, wrong = lost + found.lost, back + found.came_back, wrong + bool(found.wrong)
        if (seed + 1) % 25 == 0:
            print(
                f"{seed + 1} schedules, {time.monotonic() - begun:.0f} s: {dict(ended)}, {wrong} wrong",
                flush=True,
            )
    print(
        f"{asked.schedules} schedules in {time.monotonic() - begun:.0f} s: {dict(ended)}; {lost} cells lost, "
        f"{back} came back; {wrong} with something that does not hold"
    )
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
