"""Plot of a ladder of fidelity: cost of each rung against its distance from the top rung."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from deploy.plots.theme import DPI, draw_heading, write_picture
from deploy.util.formatting import plural

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from deploy.scenes.scene import Scene
    from deploy.studies.effects.ladder import RungResult

FILE_NAME = "ladder.png"
_WIDTH, _AROUND, _LINE_HEIGHT, _LEAST_LINES = 12.4, 1.6, 0.32, 12
_INK, _DIM, _LINE, _DOT, _TOP, _BESIDE = (
    "#22272e", "#8b95a1", "#c9d0d8", "#2f6f9f", "#b3541e", "#8fa0b2",
)  # fmt: skip
Point = tuple[int, float, float, bool]
"""A rung's number from 1, its wall time in s, its distance in mm, and whether it stands beside the ladder."""


def draw_ladder(scene: Scene, climbed: Sequence[RungResult], path: Path) -> None:
    """Draw cost against distance as a PNG.

    Args:
        scene: Whose ladder it is.
        climbed: The rungs, from the bottom.
        path: The file to write.

    Raises:
        DeployError: It can't be written.
    """
    write_picture(lambda: _figure(scene, climbed), path)


def _figure(scene: Scene, climbed: Sequence[RungResult]) -> Figure:
    from matplotlib.figure import Figure

    inside = _LINE_HEIGHT * max(len(climbed), _LEAST_LINES)
    height = _AROUND + inside
    figure = Figure(figsize=(_WIDTH, height), dpi=DPI, facecolor="white")
    axes = figure.add_axes((0.8 / _WIDTH, 0.6 / height, 6.3 / _WIDTH, inside / height))
    words = figure.add_axes((7.4 / _WIDTH, 0.6 / height, 4.8 / _WIDTH, inside / height))
    points = [
        (number, one.wall_s, 1e3 * (one.distance.displacement_m or 0.0), bool(one.rung.instead))
        for number, one in enumerate(climbed, start=1)
        if one.distance is not None and one.wall_s is not None
    ]
    _draw_points(axes, points)
    _draw_words(words, climbed)
    facts = [
        scene.name,
        plural(len(scene.lattice()), "cell"),
        f"{scene.duration_s:g} s",
        "each rung adds to those before it",
    ]
    draw_heading(figure, f"Cost against fidelity: {scene.name}", "  ·  ".join(facts), 0.35)
    return figure


def _draw_points(axes: Axes, points: Sequence[Point]) -> None:
    """The rungs with their numbers; what is no distance from the top, at the axis' foot."""
    from matplotlib.ticker import LogLocator, NullLocator

    axes.set_xscale("log")
    axes.set_yscale("log")
    far = [mm for _, _, mm, _ in points if mm > 0.0]
    foot = 0.2 * min(far, default=1.0)
    places = [(number, wall, mm if mm > 0.0 else foot, beside) for number, wall, mm, beside in points]
    line = [(wall, mm) for _, wall, mm, beside in places if not beside]
    axes.plot([wall for wall, _ in line], [mm for _, mm in line], color=_LINE, lw=1.3, zorder=2)
    for number, wall, mm, beside in places:
        shade = _BESIDE if beside else _TOP if mm == foot else _DOT
        axes.plot(wall, mm, "o", ms=15, color=shade, mec="white", mew=1.2, zorder=3)
        axes.text(
            wall, mm, str(number), color="white", ha="center", va="center", size=8, weight="bold", zorder=4
        )
    axes.set_yticks(*_ticks(foot, far))
    axes.yaxis.set_minor_locator(NullLocator())
    axes.axhline(foot, color=_LINE, lw=0.8, ls=(0, (4, 3)), zorder=1)
    axes.annotate(
        "0: the top rung", (0.0, foot), xycoords=("axes fraction", "data"), xytext=(4, 4),
        textcoords="offset points", color=_DIM, size=8,
    )  # fmt: skip
    axes.set_ylim(0.5 * foot, 3.0 * max(far, default=1.0))
    axes.margins(x=0.12)
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("wall time of a run (s)")
    axes.set_ylabel("farthest corner at the end, from the top rung's (mm)")
    axes.grid(visible=True, which="major", color="#eef1f4", lw=0.8, zorder=0)


def _ticks(foot: float, far: Sequence[float]) -> tuple[list[float], list[str]]:
    """Places and labels on the axis of distances: 0 at its foot, above it 1, 2, 5, 10 or only powers of ten."""
    low, high = math.log10(min(far, default=1.0)), math.log10(max(far, default=1.0))
    steps = (1, 2, 5) if high - low < 3.0 else (1,)
    decades = range(math.floor(low) - 1, math.ceil(high) + 1)
    values = [step * 10.0**decade for decade in decades for step in steps]
    shown = [value for value in values if 1.5 * foot < value <= 3.0 * 10.0**high]
    return [foot, *shown], ["0", *(f"{value:g}" for value in shown)]


def _draw_words(axes: Axes, climbed: Sequence[RungResult]) -> None:
    """Draw one line a rung: number, name and addition; omitted rungs in grey."""
    axes.set_axis_off()
    axes.set_xlim(0.0, 1.0)
    lines = max(len(climbed), _LEAST_LINES)
    axes.set_ylim(lines, 0.0)
    for number, one in enumerate(climbed, start=1):
        there = one.distance is not None
        y = number - 0.5
        axes.text(
            0.02,
            y,
            str(number),
            ha="right",
            va="center",
            size=9,
            weight="bold",
            color=_INK if there else _LINE,
        )
        axes.text(
            0.06, y - 0.17, one.rung.name, va="center", size=9, weight="bold", color=_INK if there else _DIM
        )
        note = one.rung.words if there else f"left out: {one.reason}"
        axes.text(0.06, y + 0.27, _cut(note), va="center", size=7.5, color=_DIM, parse_math=False)


def _cut(text: str, length: int = 82) -> str:
    return text if len(text) <= length else text[: length - 1].rstrip() + "…"
