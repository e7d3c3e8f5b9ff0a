"""What a Dask cluster of two workers makes of a campaign's runs, beside the same runs in one process.

``python tests/benchmarks/deploy/cluster_campaign.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from statistics import median
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

import psutil

from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.studies.campaign.cases import with_seed
from deploy.studies.campaign.cluster import ClusterExecutor
from deploy.studies.campaign.pool import Executor, ExecutorPool
from deploy.util.formatting import say
from deploy.workers.cluster import LOCAL, DaskCluster

WORKERS = 2
METHOD = """\
Method. The scene noisy (196 cells), {duration:g} s simulated, {runs} runs with different seeds, in turns of {turn}
runs: first in one worker process without a cluster, then on a Dask cluster of {workers} workers on this machine, whose
scheduler and client share the processors. Ideal is half the wall time of the one process, and its processor time.
Workers have done a run before; the start of the cluster is told apart. Processor time is that of this process and
of all below it. Digests of both are compared. Wall times want a quiet machine.
"""


class Spent(NamedTuple):
    """Time of some runs."""

    wall_s: float
    processor_s: float


def look() -> None:
    """Nobody interrupts."""


def processor_s() -> float:
    """Processor time of this process and of all below it, so far; those that have ended are in their parents'."""
    own = psutil.Process()
    total = 0.0
    for process in (own, *own.children(recursive=True)):
        times = process.cpu_times()
        total += times.user + times.system
        if process != own:
            total += times.children_user + times.children_system
    return total


def spent(executor: Executor, scenes: list[Scene], digests: list[str | None]) -> Spent:
    """Run scenes and add their digests in order."""
    wall_s, used_s = time.perf_counter(), processor_s()
    records = dict(executor.map(scenes))
    assert all(record.status == "ok" for record in records.values())
    digests += [records[place].digest for place in range(len(scenes))]
    return Spent(time.perf_counter() - wall_s, processor_s() - used_s)


def total(turns: list[Spent]) -> Spent:
    return Spent(*map(sum, zip(*turns, strict=True)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--turn", type=int, default=100)
    parser.add_argument("--duration", type=float, default=1.0)
    asked = parser.parse_args()
    print(METHOD.format(**vars(asked), workers=WORKERS))
    scene = load_scene("noisy", [Override(("duration_s",), asked.duration, "")])
    scenes = [with_seed(scene, seed) for seed in range(asked.runs)]
    alone: list[Spent] = []
    clustered: list[Spent] = []
    digests: tuple[list[str | None], list[str | None]] = ([], [])
    begun = time.perf_counter()
    with ExecutorPool(1, 600.0, look) as pool, DaskCluster(LOCAL, WORKERS) as cluster:
        executor = ClusterExecutor(cluster, scene, 600.0, look, check=False, say=say)
        executor.warm([scene])
        for one in (pool, executor):
            spent(one, scenes[: 2 * WORKERS], [])
        start_s = time.perf_counter() - begun
        for first in range(0, asked.runs, asked.turn):
            part = scenes[first : first + asked.turn]
            alone.append(spent(pool, part, digests[0]))
            clustered.append(spent(executor, part, digests[1]))
    ideal, real = total(alone), total(clustered)
    print(f"start of both, with a run in each worker: {start_s:.1f} s")
    print(f"one process: {ideal.wall_s:.1f} s, processor time {ideal.processor_s:.1f} s")
    print(f"cluster: {real.wall_s:.1f} s, processor time {real.processor_s:.1f} s")
    print(f"digests that differ: {sum(one != other for one, other in zip(*digests, strict=True))}")
    ratios = [one.wall_s / WORKERS / other.wall_s for one, other in zip(alone, clustered, strict=True)]
    print(f"of ideal by wall time, median of the turns: {median(ratios):.3f}")
    print(
        f"of ideal: {ideal.wall_s / WORKERS / real.wall_s:.3f} by wall time, "
        f"{ideal.processor_s / real.processor_s:.3f} by processor time"
    )


if __name__ == "__main__":
    main()
