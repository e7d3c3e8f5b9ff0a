"""What checked invariants, traced messages and recorded registers cost a run, beside the same run without.

``python tests/benchmarks/deploy/observation_cost.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions

METHOD = """\
Method. The scene tree (spanning_tree, 112 cells) for {seconds} s of simulated time, in one process without a bus,
recorded. The four runs take turns; a figure is the median of {turns} turns, the ratio the median of the turns' ratios
to the run without.
"""
KINDS: dict[str, dict[str, Any]] = {
    "nothing asked for": {},
    "--check count": {"check": "count"},
    "--trace-messages all": {"trace_messages": "all"},
    "--registers 1": {"registers": 1},
}


def ticks_per_s(seconds: float, options: dict[str, Any]) -> float:
    """Pace of one run."""
    scene = load_scene("tree", [Override(("duration_s",), seconds, "--seconds")])
    with tempfile.TemporaryDirectory() as folder:
        given = RunOptions(0, "memory", output=Path(folder) / "run", picture=False, **options)
        found = run(scene, given, quiet=True).summary
    assert found.ticks_per_s is not None
    return found.ticks_per_s


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--seconds", type=float, default=7.0, help="simulated time of a run, s")
    asked = parser.parse_args()
    print(METHOD.format(seconds=asked.seconds, turns=asked.turns))
    ticks_per_s(0.1, {})  # loads the kernels
    turns = [
        {kind: ticks_per_s(asked.seconds, options) for kind, options in KINDS.items()}
        for _ in range(asked.turns)
    ]
    without = next(iter(KINDS))
    for kind in KINDS:
        pace, ratio = (
            median(turn[kind] for turn in turns),
            median(turn[kind] / turn[without] for turn in turns),
        )
        print(f"{kind:<24} {pace:>8,.0f} ticks/s   ratio {ratio:.2f}")


if __name__ == "__main__":
    main()
