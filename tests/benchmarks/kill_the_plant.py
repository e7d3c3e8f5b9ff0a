"""Kills the plant's process at random instants, and holds what the run comes to against the same run uninterrupted.

Every run is killed several times, also while it goes on from a checkpoint and while it writes one: after the first
checkpoint that it leaves, at an instant drawn evenly from two intervals. Prints a line a kill; fails if a digest
differs, a tick is missing in the recording or there twice, more than an interval has to be done again (and what a
checkpoint takes longer to write than the one before it), or a process is left.

    python tests/benchmarks/kill_the_plant.py --instants 50
    python tests/benchmarks/kill_the_plant.py --instants 50 --processes each --scene prototype
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from tests.system.killed import assert_whole, ended, kill_after, start

KILLS_A_RUN = 5
LATER_S = 0.1
"""Wall time by which a checkpoint may come later than the one before lets expect, on a machine that does other work."""
PACE = 2
"""Simulated seconds a wall second: a run that is over can't be killed."""


def main() -> int:
    """Read the options, kill, and say how often it went wrong."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--instants", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--scene", default="elliptic")
    parser.add_argument("--processes", default="1")
    parser.add_argument("--duration", type=float, default=6.0)
    parser.add_argument("--checkpoint", type=float, default=0.25)
    parser.add_argument("--limit", type=float, default=900.0, help="Begin no run after so many seconds.")
    asked = parser.parse_args()
    draw, begun = np.random.default_rng(asked.seed), time.monotonic()
    killed = 0
    scene = (asked.scene, "--duration", asked.duration, "--processes", asked.processes)
    with tempfile.TemporaryDirectory() as folder:
        whole = ended(start(Path(folder), *scene, "--realtime", PACE, "--output", folder))
    while killed < asked.instants and time.monotonic() < begun + asked.limit:
        killed += _one(scene, asked, draw, min(KILLS_A_RUN, asked.instants - killed), whole)
    print(f"{killed} kills, every run to the digest of the uninterrupted one: {whole['digest']}")
    return 0 if killed >= asked.instants else 1


def _one(
    scene: tuple[Any, ...],
    asked: argparse.Namespace,
    draw: np.random.Generator,
    kills: int,
    whole: dict[str, Any],
) -> int:
    """One run, killed several times, to its end; returns how often it could be."""
    with tempfile.TemporaryDirectory() as name:
        folder, last, done = Path(name), 0, 0
        run = start(folder, *scene, "--realtime", PACE, "--checkpoint", asked.checkpoint, "--output", folder)
        while done < kills:
            delay_s = float(draw.uniform(0.0, 2.0 * asked.checkpoint))
            kill = kill_after(run, last, delay_s)
            if kill is None:
                break  # it was over before
            done += 1
            print(
                f"killed {delay_s:.3f} s after a checkpoint: goes on before tick {kill.tick}, from one that was "
                f"written {kill.age_s:.3f} s before",
                flush=True,
            )
            assert kill.age_s <= asked.checkpoint + LATER_S, "more than one interval is done again"
            last = kill.tick
            run = start(folder, "--resume", folder, *(() if done == kills else ("--realtime", PACE)))
        if done:
            summary = ended(run)
            assert summary["digest"] == whole["digest"], f"{summary['digest']}: not {whole['digest']}"
            assert summary["messages"] == whole["messages"], f"{summary['messages']}: not {whole['messages']}"
            assert_whole(folder, whole["ticks"], whole["digest"])
        return done


if __name__ == "__main__":
    sys.exit(main())
