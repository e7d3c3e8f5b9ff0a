"""Parcels brought to the middle of an array by the cells' own estimate, whatever share of the cells is dead.

``python tests/benchmarks/protocols/parcel_estimate_study.py`` prints its method and its figures, beside those of the
diffusion-controlled tiles of Bessone et al.; ``--output DIR`` writes them as CSV and as a picture, too.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))
sys.path.insert(0, str(Path(__file__).resolve().parent))

from parcel_estimate_case import PITCH_M, Case, run

from deploy.plots.theme import write_picture
from deploy.studies.accuracy.experiments.markdown import panels
from deploy.util.colours import colour

SIZES = (2, 3, 4, 5)
DEAD_PERCENT = (0, 10, 30, 50, 70, 90)
WHEEL_M = 0.06
THEIRS = {
    0: (0.26, 0.20, 0.18, 0.10),
    10: (0.73, 0.36, 0.58, 0.24),
    30: (2.68, 1.39, 0.51, 0.64),
    50: (5.11, 5.55, 2.70, 1.80),
}
"""Mean position error, tiles, of their tables: by the share of dead tiles, for parcels 2 to 5 tiles large."""
METHOD = f"""\
Method. 25 x 25 cells, pitch {PITCH_M} m, one sensor a cell. A square parcel starts anywhere it stands, at any
angle; parcel_estimate brings it to the middle; {{seconds:g}} s, control period 16.384 ms, viscous friction 0.2 s/m, at
most 0.2 m/s. Dead cells are drawn by the seed, dead from the start; their wheels coast and carry. {{seeds}} seeds.
"error": distance of the parcel's true centre from the middle at the end, in cells: mean, and the error of the mean;
median; greatest. "estimate": distance of the leader's estimate from the true pose, root mean square from the second
second on, mm and degrees (of the group that carries most). "tipped": parcels that fell over an edge of the cells under
them, and stay there. "unmoved": that no living cell was ever under. Wheels are points, but with "w", where they are
{WHEEL_M * 1e3:g} mm wide (contact_width). "theirs": Bessone et al., without physics, time, messages.
"""
HEADER = (
    "size", "wheels", "dead_percent", "mean", "error_of_mean", "median", "greatest",
    "estimate_mm", "estimate_deg", "tipped", "unmoved", "theirs",
)  # fmt: skip
Row = tuple[float | int | str, ...]


def row(asked: tuple[int, str, int, int, float]) -> Row:
    """A line of the table."""
    size, wheels, dead, seeds, seconds = asked
    wide = WHEEL_M if wheels == "w" else 0.0
    course = run(Case((size * PITCH_M, size * PITCH_M), dead, seeds=seeds, seconds=seconds, wheel_m=wide))
    error = np.hypot(course.truth[-1, :, 0], course.truth[-1, :, 1]) / PITCH_M
    later = course.time_s >= 2.0
    away = course.estimate[later, :, :2] - course.truth[later, :, :2]
    angle = np.arctan2(course.estimate[later, :, 3], course.estimate[later, :, 2]) - course.truth[later, :, 2]
    turned = np.degrees(np.mod(angle + np.pi / 4, np.pi / 2) - np.pi / 4)
    moved = np.hypot(*(course.truth[-1, :, :2] - course.truth[0, :, :2]).T)
    theirs = THEIRS[dead][SIZES.index(size)] if dead in THEIRS else float("nan")
    return (
        size,
        wheels,
        dead,
        float(error.mean()),
        float(error.std(ddof=1) / np.sqrt(seeds)),
        float(np.median(error)),
        float(error.max()),
        1e3 * float(np.sqrt(np.nanmean((away * away).sum(axis=-1)))),
        float(np.sqrt(np.nanmean(turned * turned))),
        sum(status == "tipped" for status in course.status),
        int((moved == 0.0).sum()),
        theirs,
    )


def rows(seeds: int, seconds: float, dead_percent: Sequence[int]) -> Iterator[Row]:
    """The table, in two processes."""
    asked = [
        (size, wheels, dead, seeds, seconds)
        for size, wheels in ((3, ""), (4, ""), (5, ""), (2, "w"), (2, ""))
        for dead in dead_percent
    ]
    with get_context("spawn").Pool(2) as pool:
        yield from pool.imap(row, asked)


def picture(table: list[Row]) -> Figure:
    """Draw the error against the share of dead cells, a curve for each size, theirs beside ours."""
    kinds = list(dict.fromkeys((line[0], line[1]) for line in table))
    figure, axes = panels(
        "Estimate of a parcel's place while cells are dead",
        "mean error over 20 seeds with its spread, in cells; an error below 1e-3 is drawn there",
        widths_in=(2.0,) * len(kinds),
        height_in=2.9,
    )
    for axis, (size, wheels) in zip(axes, kinds, strict=True):
        lines = [line for line in table if line[:2] == (size, wheels)]
        dead: Any = [line[2] for line in lines]
        mean, spread = np.array([line[3] for line in lines]), np.array([line[4] for line in lines])
        axis.errorbar(
            dead,
            np.maximum(mean, 1e-3),
            yerr=spread,
            color=colour(0),
            marker="o",
            ms=4,
            capsize=2,
            label="parcel_estimate",
        )
        axis.plot(dead, [line[11] for line in lines], "s--", color=colour(1), ms=4, label="Bessone et al.")
        axis.set_title(f"{size} × {size}" + (", wide wheels" if wheels else ""), loc="left", size=9)
        axis.set(xlabel="dead cells (%)", yscale="log", ylim=(8e-4, 20))
    axes[0].set_ylabel("mean error (cells)")
    axes[0].legend(frameon=False, fontsize=7.5, loc="lower right")
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=18.0)
    parser.add_argument(
        "--dead", type=int, choices=DEAD_PERCENT, action="append", help="percent, only so many"
    )
    parser.add_argument("--output", type=Path)
    asked = parser.parse_args()
    print(METHOD.format(seeds=asked.seeds, seconds=asked.seconds))
    print(" ".join(f"{name:>13}" for name in HEADER))
    table: list[Row] = []
    for line in rows(asked.seeds, asked.seconds, asked.dead or DEAD_PERCENT):
        table.append(line)
        print(
            " ".join(f"{value:13.3f}" if isinstance(value, float) else f"{value!s:>13}" for value in line),
            flush=True,
        )
    if asked.output is not None:
        asked.output.mkdir(parents=True, exist_ok=True)
        text = "\n".join(",".join(map(str, line)) for line in (HEADER, *table))
        (asked.output / "parcel_estimate_study.csv").write_text(text + "\n")
        write_picture(lambda: picture(table), asked.output / "parcel_estimate_study.png")


if __name__ == "__main__":
    main()
