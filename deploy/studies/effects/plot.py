"""Plot of a ladder of fidelity: cost of each rung against its distance from the top rung."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

import textwrap
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
_WIDTH, _ROW, _ABOVE, _BELOW = 12.8, 0.44, 1.0, 0.7
"""Width of the page, height of a rung and of what is above and below all rungs, inches."""
_WORDS, _PANEL, _GAP = 5.7, 3.1, 0.35
"""Width of the text and of a panel, and the gap between two of them, inches."""
_LINE_LENGTH = 94
"""Characters of a line of text."""
_INK, _DIM, _LINE, _DOT, _TOP, _BESIDE = (
    "#22272e", "#8b95a1", "#c9d0d8", "#2f6f9f", "#b3541e", "#8fa0b2",
)  # fmt: skip


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

    inside = _ROW * max(len(climbed), 1)
    height = _ABOVE + inside + _BELOW
    figure = Figure(figsize=(_WIDTH, height), dpi=DPI, facecolor="white")
    lefts = 0.15, 0.15 + _WORDS, 0.15 + _WORDS + _PANEL + _GAP
    words, cost, distance = (
        figure.add_axes((left / _WIDTH, _BELOW / height, width / _WIDTH, inside / height))
        for left, width in zip(lefts, (_WORDS, _PANEL, _PANEL), strict=True)
    )
    for axes in (words, cost, distance):
        axes.set_ylim(0.0, max(len(climbed), 1))  # fidelity rises upwards
    _draw_words(words, climbed)
    _draw_cost(cost, climbed)
    _draw_distance(distance, climbed)
    facts = [
        scene.name,
        plural(len(scene.lattice()), "cell"),
        f"{scene.duration_s:g} s",
        "each rung adds to those below it",
    ]
    draw_heading(figure, f"Cost against fidelity: {scene.name}", "  ·  ".join(facts), 0.35)
    return figure


def _rows(climbed: Sequence[RungResult]) -> list[tuple[float, RungResult, str]]:
    """Height, rung and colour of every rung that was run."""
    found: list[tuple[float, RungResult, str]] = []
    for number, one in enumerate(climbed):
        if one.distance is not None:
            shade = _BESIDE if one.rung.instead else _TOP if one.distance.none else _DOT
            found.append((number + 0.5, one, shade))
    return found


def _prepare(axes: Axes, label: str) -> None:
    from matplotlib.ticker import LogLocator, NullLocator

    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(numticks=8))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_xlabel(label)
    axes.grid(visible=True, axis="x", color="#eef1f4", lw=0.8, zorder=0)


def _draw_cost(axes: Axes, climbed: Sequence[RungResult]) -> None:
    """Draw the median wall time of each rung, with its value, and the range of the runs."""
    _prepare(axes, "wall time of a run (s)\nmedian; bars: shortest to longest")
    rows = [(y, one.walls_s, one.wall_s or 0.0, shade) for y, one, shade in _rows(climbed)]
    axes.plot([wall for _, _, wall, _ in rows], [y for y, *_ in rows], color=_LINE, lw=1.2, zorder=1)
    for y, walls_s, wall_s, shade in rows:
        axes.plot([min(walls_s), max(walls_s)], [y, y], color=shade, lw=1.0, zorder=2)
        axes.plot(wall_s, y, "o", ms=7, color=shade, mec="white", mew=0.8, zorder=3)
        _label(axes, max(walls_s), y, _two(wall_s))
    _widen(axes, [second for _, walls_s, _, _ in rows for second in walls_s])


def _draw_distance(axes: Axes, climbed: Sequence[RungResult]) -> None:
    """Draw the largest distance of each rung's run from the top rung's; the top itself is at the left edge."""
    _prepare(axes, "distance from the top rung's run (mm)\nlargest of a corner at any time")
    rows = [
        (y, 1e3 * one.distance.displacement_m, shade)
        for y, one, shade in _rows(climbed)
        if one.distance is not None and one.distance.displacement_m is not None
    ]
    far = [mm for _, mm, _ in rows if mm > 0.0]
    foot = 0.3 * min(far, default=1.0)
    axes.plot([mm or foot for _, mm, _ in rows], [y for y, *_ in rows], color=_LINE, lw=1.2, zorder=1)
    for y, mm, shade in rows:
        axes.plot(mm or foot, y, "o", ms=7, color=shade, mec="white", mew=0.8, zorder=3)
        _label(axes, mm or foot, y, _two(mm))
    _widen(axes, [foot, *far])


def _two(value: float) -> str:
    """Two digits, or whole."""
    return f"{value:.0f}" if value >= 10.0 else f"{value:.2g}"


def _label(axes: Axes, x: float, y: float, text: str) -> None:
    axes.annotate(
        text, (x, y), xytext=(7, 0), textcoords="offset points", va="center", size=8, color=_INK, zorder=4
    )


def _widen(axes: Axes, values: Sequence[float]) -> None:
    """Leave room for the values beside the points."""
    if values:
        ratio = max(values) / min(values)
        axes.set_xlim(min(values) / max(ratio, 10.0) ** 0.06, max(values) * max(ratio, 10.0) ** 0.18)


def _draw_words(axes: Axes, climbed: Sequence[RungResult]) -> None:
    """Draw number, name and addition of each rung; omitted rungs in grey with the reason."""
    axes.set_axis_off()
    axes.set_xlim(0.0, _WORDS)
    for number, one in enumerate(climbed):
        there = one.distance is not None
        ink = _INK if there else _DIM
        y = number + 0.5
        axes.text(0.2, y + 0.22, str(number + 1), ha="right", va="center", size=9, weight="bold", color=ink)
        axes.text(0.3, y + 0.22, one.rung.name, va="center", size=9, weight="bold", color=ink)
        note = one.rung.words if there else f"left out: {one.reason}"
        lines = "\n".join(textwrap.wrap(note, _LINE_LENGTH, max_lines=2, placeholder=" …"))
        axes.text(0.3, y + 0.02, lines, va="top", size=7, color=_DIM, parse_math=False, linespacing=1.1)
