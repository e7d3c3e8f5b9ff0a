"""Random programs with one planted fault each: whether a run of each ends with the right exit status and message.

``python tests/benchmarks/deploy/planted_faults.py --programs 200`` prints, by kind of fault, how many programs ran,
and all that was not as it must be: exit status, status and reason of the summary, last line and traceback on stderr,
recording. The programs are in both forms. Most run in this process, the others in worker processes over Zenoh.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.system.planted import ONE, Planted, carry_out


def wrong_with(planted: Planted) -> list[str]:
    """What is not as it must be when a program is run."""
    with tempfile.TemporaryDirectory() as folder:
        return carry_out(planted, Path(folder))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--programs", type=int, default=200)
    parser.add_argument("--first", type=int, default=0, help="seed of the first program")
    asked = parser.parse_args()
    wrong_with(Planted("nothing", "cell", 0, (), ONE))  # kernels are compiled
    begun = time.monotonic()
    ran, wrong = Counter[str](), 0
    for seed in range(asked.first, asked.first + asked.programs):
        planted = Planted.drawn(seed)
        found = wrong_with(planted)
        for line in found:
            print(f"seed {seed}, {planted}: {line}", flush=True)
        ran[planted.kind] += 1
        wrong += bool(found)
    for kind, number in ran.items():
        print(f"{kind:13} {number}")
    print(
        f"{asked.programs} programs in {time.monotonic() - begun:.0f} s; {wrong} with something that is not right"
    )
    sys.exit(bool(wrong))


if __name__ == "__main__":
    main()
