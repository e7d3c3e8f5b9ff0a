"""How near ``implicit`` comes to Filippov's solution under ``coulomb``, and what its located slips and sticks cost.

``python tests/benchmarks/plant/coulomb_events.py`` prints its method.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.plant.filippov import LiftedError
from tests.plant.scenes import SECOND
from tests.plant.slipping import SPAN_S, controlled, distance_m, make_scene, solve_reference

METHOD = """\
Random scenes of {span:g} s on nine cells under coulomb, those without a lifted support among {seeds} seeds; capture_m a
tenth of the tolerance. Off: implicit from the event-driven reference at the footprint, over the tolerance. Steps:
attempted, of all scenes. Time: processor time of all scenes, once each.
"""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=60)
    seeds: int = parser.parse_args().seeds
    print(METHOD.format(span=SPAN_S, seeds=seeds))
    known = {}
    changes = 0
    for seed in range(seeds):
        try:
            reference, end = solve_reference(seed)
        except LiftedError:
            continue
        known[seed] = end
        changes += len(reference.events)
    print(f"{len(known)} scenes, {changes} events of wheels and edges\n")
    print(f"{'tolerance':>10} {'off: median':>12} {'worst':>9} {'steps':>8} {'time, s':>9}")
    for tolerance in (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10):
        off: list[float] = []
        steps, spent = 0, 0.0
        for seed, end in known.items():
            plant, drives = make_scene(seed, controlled(tolerance))
            begun = time.process_time()
            plant.advance(drives, round(SPAN_S * SECOND))
            spent += time.process_time() - begun
            steps += plant.effort
            off.append(distance_m(plant, end) / tolerance)
        print(f"{tolerance:10.0e} {np.median(off):12.1e} {max(off):9.1e} {steps:8d} {spent:9.3f}")


if __name__ == "__main__":
    main()
