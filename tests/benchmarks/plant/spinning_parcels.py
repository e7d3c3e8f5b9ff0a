"""Whether ``implicit`` holds its tolerance where parcels spin, and what that costs beside ``exact``.

``python tests/benchmarks/plant/spinning_parcels.py`` prints its method.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from tests.plant.spinning import (
    CAPTURE,
    LAWS,
    SCENES,
    SENSITIVE,
    SPAN_S,
    TOLERANCES,
    Scene,
    end,
    measure,
    scene,
)

METHOD = """\
{scenes} random scenes of {span:g} s: one parcel, spins up to 30 rad/s, laws and tolerances in turn, capture_m
{capture:g} of the tolerance. Off: implicit from exact at a thousandth of the tolerance (1e-13 at least), at the
footprint, over the tolerance. Scenes whose exact end moves by more than {sensitive:g} tolerances where the start moves
by one are counted apart. Time: processor time of a scene, median, least of {turns} turns each, implicit beside exact at
the same tolerance.
"""


def cost_s(one: Scene, name: str, turns: int) -> float:
    """Least processor time in which a solver takes a scene to its end, s, the plant's making included."""
    settings = {"name": name, "tolerance": one.tolerance, "capture_m": CAPTURE * one.tolerance}
    spent: list[float] = []
    for _ in range(turns):
        begun = time.process_time()
        end(one, settings)
        spent.append(time.process_time() - begun)
    return min(spent)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scenes", type=int, default=SCENES)
    parser.add_argument("--turns", type=int, default=3, help="for each time")
    given = parser.parse_args()
    scenes: int = given.scenes
    turns: int = given.turns
    print(METHOD.format(scenes=scenes, span=SPAN_S, capture=CAPTURE, sensitive=SENSITIVE, turns=turns))
    outcomes = [measure(scene(seed)) for seed in range(scenes)]
    meant = [one for one in outcomes if not one.sensitive]
    off = np.array([one.off for one in meant])
    apart = len(outcomes) - len(meant)
    worst = meant[int(np.argmax(off))].scene
    most = max([0.0, *(one.off for one in outcomes if one.sensitive)])
    print(f"counted apart: {apart} ({apart / scenes:.1%}), off by at most {most:.2g}")
    print(f"the others: median {np.median(off):.2g}, 95 % below {np.quantile(off, 0.95):.2g}, ", end="")
    print(f"worst {off.max():.2g} (seed {worst.seed}), ", end="")
    print(f"within 1: {np.mean(off <= 1.0):.1%}, within 10: {np.mean(off <= 10.0):.1%}\n")
    print(f"{'law':12}{'tolerance':>10}{'scenes':>8}{'implicit':>12}{'exact':>12}{'ratio':>8}")
    for law in LAWS:
        for tolerance in TOLERANCES[::3]:
            chosen = [
                one.scene for one in outcomes if (one.scene.law, one.scene.tolerance) == (law, tolerance)
            ]
            if chosen:
                ours, exact = (
                    float(np.median([cost_s(one, name, turns) for one in chosen]))
                    for name in ("implicit", "exact")
                )
                print(f"{law:12}{tolerance:10.0e}{len(chosen):8}", end="")
                print(f"{ours * 1e3:9.2f} ms{exact * 1e3:9.2f} ms{ours / exact:8.1f}")


if __name__ == "__main__":
    main()
