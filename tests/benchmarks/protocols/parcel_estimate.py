"""How well cells estimate where a parcel is: by sensors a cell, over bad links, drifting clocks, dead and dying cells.

``python tests/benchmarks/protocols/parcel_estimate.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

from parcel_estimate_case import PITCH_M, Case, run

SIZE_M, CELLS, SECONDS = (0.5, 0.3), 15, 9.0
CASES: dict[str, dict[str, Any]] = {
    "1 sensor": {},
    "3 sensors": {"sensors": 3},
    "5 sensors": {"sensors": 5},
    "loss 0.05": {"effects": {"link_loss": {"probability": 0.05}}},
    "loss 0.2": {"effects": {"link_loss": {"probability": 0.2}}},
    "delay 4": {"effects": {"link_delay": {"ticks": 4}}},
    "clocks off by up to 1 %": {"effects": {"clock": {"error_ppm": 10_000}}},
    "10 % dead": {"dead_percent": 10.0},
    "10 % die on the way": {"dying_percent": 10.0},
}
METHOD = f"""\
Method. A parcel of {SIZE_M[0]} x {SIZE_M[1]} m on {CELLS} x {CELLS} cells, pitch {PITCH_M} m, starts anywhere, at
any angle; parcel_estimate brings it to the middle in {SECONDS:g} s; control period 16.384 ms, one sensor a cell but
where it says otherwise; {{seeds}} seeds. The estimate of the group that carries most beside the true pose, every 0.2 s,
while "moving" (from 1 to 4 s) and at "rest" (the last 2 s): root mean square, mm and degrees, of all seeds. "none":
share of those looks from 1 s on in which no leader knew a pose. "leaders": how many did, mean. "end": distance of the
true centre from the middle at the end, mean and greatest, mm.
"""


def line(asked: tuple[str, int]) -> str:
    """A line of the table."""
    name, seeds = asked
    course = run(Case(SIZE_M, CELLS, seeds=seeds, seconds=SECONDS, **CASES[name]))
    away = 1e3 * (course.estimate[:, :, :2] - course.truth[:, :, :2])
    angle = np.arctan2(course.estimate[:, :, 3], course.estimate[:, :, 2]) - course.truth[:, :, 2]
    turned = np.degrees(np.mod(angle + np.pi / 2, np.pi) - np.pi / 2)
    text = f"{name:28}"
    for part in ((course.time_s >= 1.0) & (course.time_s < 4.0), course.time_s >= SECONDS - 2.0):
        off = np.sqrt(np.nanmean((away[part] ** 2).sum(axis=-1)))
        text += f"{off:9.1f}{np.sqrt(np.nanmean(turned[part] ** 2)):7.2f}"
    later = course.time_s >= 1.0
    end = 1e3 * np.hypot(course.truth[-1, :, 0], course.truth[-1, :, 1])
    none, leaders = np.isnan(away[later, :, 0]).mean(), course.leaders[later].mean()
    return f"{text}{none:8.3f}{leaders:9.2f}{end.mean():8.2f}{end.max():8.1f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES), metavar="CASE")
    asked = parser.parse_args()
    print(METHOD.format(seeds=asked.seeds))
    print(
        f"{'':28}{'moving mm':>9}{'deg':>7}{'rest mm':>9}{'deg':>7}{'none':>8}{'leaders':>9}{'end mm':>8}{'max':>8}"
    )
    with get_context("spawn").Pool(2) as pool:
        for text in pool.imap(line, [(name, asked.seeds) for name in asked.cases]):
            print(text, flush=True)


if __name__ == "__main__":
    main()
