"""How fast runs are, each beside a bare Zenoh exchange of the same payloads.

``python tests/benchmarks/fast.py`` measures, prints its method and writes a picture. A section is an entry of
``SECTIONS``: what it measures, prints and draws.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
# the server that forks the workers knows no other way to find their modules
os.environ["PYTHONPATH"] = os.pathsep.join(sys.path)

from fast_runs import CASES, WARM_TICKS, measure

from deploy.plots.theme import draw_heading, write_picture

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Row = dict[str, Any]
REAL, BARE = "#2f6f9f", "#c9d3dc"

EACH = """\
A process a cell. The plant is this process; each cell has a process of its own, as with mdms run --processes each,
and the wire format is the default of that. Runs are recorded and have their digest. prototype: 18 boards with
drifting clocks, encoders, PWM, integers, serial lines and watchdogs under a moving parcel. heat: wheel speeds spread
from two held columns.
"""
BY_KEY = """\
A process a cell, beside an exchange with a payload per cell and link: how the values of a tick are sent where no plant
passes messages on (wire format per_cell).
"""
HELICS = """\
A process a cell, beside HELICS: a federate of its own in each of as many processes, core zmq, which computes nothing,
publishes as many values as a cell sends, and reads them a step later; a tick is one time step of all.
"""
PACKED = """\
Packed runs. The plant is this process, with workers beside it as mdms run has them. Up to 10,000 cells a run is
recorded and has its digest, but where its name says otherwise; larger ones have neither. The wire format is the
default of mdms run. heat: wheel speeds spread from two held columns, ideal wheels, one parcel. 50 parcels: the parcels
of large on cells with motors and speed loops, all moving.
"""
BARE_SIDE = """\
The bare side is plain Zenoh code (FifoChannel, recv, put) with as many processes, which exchanges payloads of the same
number and sizes and reads none of them.
"""
TURNS = """\
A case has a process of its own; its two sides take {turns} turns each of
{seconds} s (two ticks at least), each first in every other pair, after {warm} ticks to warm up, so that what else the
machine does meets both alike. "ratio" is the median over pairs of turns, beside the least and the largest; rates and
processor time a tick (schedstat, all threads; the workers' together) are medians. PSS is of all processes of the run
after warming up.
"""
COMMON = BARE_SIDE + TURNS


def runs(section: str, options: argparse.Namespace) -> list[Row]:
    """Measure the runs of a section, a process a case."""
    rows: list[Row] = []
    for number, case in enumerate(CASES[section]):
        if options.cells and case.cells not in options.cells:
            continue
        if options.workers and case.workers not in options.workers:
            continue
        command = [
            sys.executable,
            __file__,
            "--section",
            section,
            "--case",
            str(number),
            "--turns",
            str(options.turns),
        ]
        command += ["--seconds", str(options.seconds)]
        done = subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True)
        rows.append(json.loads(done.stdout))
    return rows


def print_runs(method: str, rows: list[Row], options: argparse.Namespace) -> None:
    """Print the method and the figures of runs."""
    print(method.format(turns=options.turns, seconds=options.seconds, warm=WARM_TICKS))
    heads = (
        "ticks/s",
        "bare",
        "ratio",
        "range",
        "must",
        "goal",
        "plant us",
        "workers us",
        "bare us",
        "PSS MB",
    )
    widths = (10, 10, 7, 13, 6, 7, 10, 11, 10, 8)
    print(f"{'':44}" + "".join(f"{head:>{width}}" for head, width in zip(heads, widths, strict=True)))
    for row in rows:
        real, bare = row["real"], row["bare"]
        low, high = row["ratio_range"]
        fields = (
            f"{real['ticks_per_s']:,.1f}",
            f"{bare['ticks_per_s']:,.1f}",
            f"{row['ratio']:.2f}",
            f"{low:.2f}..{high:.2f}",
            "-" if row["must"] is None else f"{row['must']:.1f}",
            "-" if row["goal"] is None else f"{row['goal']:,.0f}",
            f"{real['plant_us']:,.0f}",
            f"{real['workers_us']:,.0f}",
            f"{bare['plant_us'] + bare['workers_us']:,.0f}",
            f"{row['pss_mb']:,.0f}",
        )
        name = row["title"] + (", recorded" if row["recorded"] else "")
        print(f"{name:44}" + "".join(f"{text:>{width}}" for text, width in zip(fields, widths, strict=True)))


def draw_runs(rows: list[Row], axes: Axes) -> None:
    """Draw the rates of runs, real and bare, with the goals."""
    for place, row in enumerate(rows):
        axes.barh(
            place - 0.2, row["bare"]["ticks_per_s"], 0.36, color=BARE, label="bare" if place == 0 else None
        )
        axes.barh(
            place + 0.2, row["real"]["ticks_per_s"], 0.36, color=REAL, label="run" if place == 0 else None
        )
        axes.text(row["real"]["ticks_per_s"], place + 0.2, f" {row['ratio']:.2f}", va="center", size=8)
        if row["goal"] is not None:
            goal = axes.plot([row["goal"]] * 2, [place, place + 0.4], color="#22272e", linewidth=1.5)
            goal[0].set_label("goal" if place == 0 else "")
    axes.set_xscale("log")
    axes.set_xlim(left=0.2 * min((row["real"]["ticks_per_s"] for row in rows), default=1.0))
    axes.set_yticks(range(len(rows)), [row["title"] for row in rows])
    axes.invert_yaxis()
    axes.set_xlabel("ticks/s (number: share of the bare rate)")
    axes.legend(frameon=False, loc="lower right")


@dataclass(frozen=True)
class Section:
    """A part of the benchmark.

    Attributes:
        title: Heading in the picture.
        measure: Returns the rows.
        show: Prints the rows.
        draw: Draws the rows.
    """

    title: str
    measure: Callable[[argparse.Namespace], list[Row]]
    show: Callable[[list[Row], argparse.Namespace], None]
    draw: Callable[[list[Row], Axes], None]


SECTIONS = {
    "each": Section("A process a cell", partial(runs, "each"), partial(print_runs, EACH + COMMON), draw_runs),
    "by_key": Section(
        "A process a cell, beside a payload per link",
        partial(runs, "by_key"),
        partial(print_runs, BY_KEY + COMMON),
        draw_runs,
    ),
    "helics": Section(
        "A process a cell, beside HELICS",
        partial(runs, "helics"),
        partial(print_runs, HELICS + TURNS),
        draw_runs,
    ),
    "packed": Section(
        "Packed runs", partial(runs, "packed"), partial(print_runs, PACKED + COMMON), draw_runs
    ),
}


def figure_of(found: dict[str, list[Row]]) -> Figure:
    """Draw the sections below each other, each as high as its rows need."""
    from matplotlib.figure import Figure

    heights = [0.42 * len(rows) + 0.9 for rows in found.values()]
    figure = Figure(figsize=(9.0, sum(heights) + 0.9))
    draw_heading(
        figure, "Runs beside a bare Zenoh exchange of the same payloads", f"{os.cpu_count()} cores", 0.3
    )
    total, top = float(figure.get_size_inches()[1]), 0.9
    for (name, rows), height in zip(found.items(), heights, strict=True):
        axes = figure.add_axes((0.38, 1 - (top + height - 0.55) / total, 0.58, (height - 0.75) / total))
        axes.set_title(SECTIONS[name].title, loc="left", size=10)
        SECTIONS[name].draw(rows, axes)
        top += height
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "--section", action="append", choices=list(SECTIONS), help="only this section; repeatable"
    )
    parser.add_argument("--cells", type=int, action="append", help="only runs of so many cells; repeatable")
    parser.add_argument(
        "--workers", type=int, action="append", help="only runs with so many workers; repeatable"
    )
    parser.add_argument("--turns", type=int, default=9, help="turns of each side")
    parser.add_argument("--seconds", type=float, default=1.0, help="length of a turn")
    parser.add_argument("--picture", metavar="FILE", default="fast.png", help="picture to write; empty: none")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--case", type=int, help=argparse.SUPPRESS)  # in a process of its own
    options = parser.parse_args()
    if options.case is not None:
        (section,) = options.section
        print(json.dumps(measure(CASES[section][options.case], options.turns, options.seconds)))
        return
    found = {name: SECTIONS[name].measure(options) for name in options.section or SECTIONS}
    if options.json:
        print(json.dumps(found))
    else:
        for name, rows in found.items():
            SECTIONS[name].show(rows, options)
    if options.picture:
        write_picture(lambda: figure_of(found), options.picture)


if __name__ == "__main__":
    main()
