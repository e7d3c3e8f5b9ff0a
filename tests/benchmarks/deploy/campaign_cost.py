"""What a campaign adds to its runs, and what a second job is worth.

``python tests/benchmarks/deploy/campaign_cost.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import resource
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
from deploy.studies.campaign.cases import with_seed
from deploy.studies.campaign.pool import ExecutorPool
from deploy.workers.plan import RunOptions
from plant.solvers.thread_pool import processors

METHOD = """\
Method. The scene noisy (196 cells), {duration:g} s simulated, {runs} seeds; the median of {turns} turns, in each of
which all are measured. Processor time a run: of mdms run in this process over the memory transport, with its recording
and without its picture; of a campaign's workers, beyond that of their start and one run, which is told apart. Runs a
second of wall time: of workers that have done runs before. {processors} processors; wall times want a quiet machine.
"""


def alone_s(scenes: list[Scene]) -> float:
    """Processor time a run of ``mdms run``, one after another in this process."""
    begun = time.process_time()
    for scene in scenes:
        with tempfile.TemporaryDirectory() as folder:
            run(scene, RunOptions(transport="memory", output=Path(folder), picture=False), quiet=True)
    return (time.process_time() - begun) / len(scenes)


def workers_s(scenes: list[Scene]) -> float:
    """Processor time of a pool with one worker from its start to its end."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    with ExecutorPool(1, 600.0, look) as pool:
        pooled_s(pool, scenes)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def pooled_s(pool: ExecutorPool, scenes: list[Scene]) -> float:
    """Wall time a run of a pool."""
    begun = time.perf_counter()
    endings = [ending for _, ending in pool.map(scenes)]
    assert all(ending.status == "ok" for ending in endings)
    return (time.perf_counter() - begun) / len(scenes)


def look() -> None:
    """Nobody interrupts."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=6)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--duration", type=float, default=1.0)
    asked = parser.parse_args()
    said = {"duration": asked.duration, "runs": asked.runs, "turns": asked.turns}
    print(METHOD.format(**said, processors=processors()))
    scene = load_scene("noisy", [Override(("duration_s",), asked.duration, "")])
    scenes = [with_seed(scene, seed) for seed in range(asked.runs)]
    turns: list[tuple[float, float, float, float, float]] = []
    with ExecutorPool(1, 600.0, look) as one, ExecutorPool(2, 600.0, look) as two:
        for pool in (one, two):
            pooled_s(pool, scenes)
        alone_s(scenes[:1])
        for _ in range(asked.turns):
            first_s = workers_s(scenes[:1])
            own_s = (workers_s(scenes) - first_s) / (len(scenes) - 1)
            turns.append(
                (alone_s(scenes), own_s, first_s - own_s, pooled_s(one, scenes), pooled_s(two, scenes))
            )
    run_s, own_s, start_s, one_s, two_s = (median(span) for span in zip(*turns, strict=True))
    print(f"processor time a run: mdms run {run_s:.3f} s, campaign {own_s:.3f} s: {own_s / run_s:.2f} of it")
    print(f"once for a campaign with one worker: {start_s:.2f} s")
    print(f"runs a second: 1 job {1 / one_s:.2f}, 2 jobs {1 / two_s:.2f}: {one_s / two_s:.2f} times")


if __name__ == "__main__":
    main()
