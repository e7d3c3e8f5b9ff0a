"""The picture of a graze: where an integrator looks, and what that costs at every tolerance."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol

import numpy as np

from deploy.accuracy.evidence.drawing import panels
from deploy.accuracy.evidence.graze_steps import Steps
from deploy.accuracy.evidence.section import power
from deploy.overview.scenery import INK, LOST, colour

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from plant.wheels import Floats


_DEEPEST, _HIGHEST = -3.4, 7.0
"""What the view of the depth shows, over the greatest depth."""


class Point(Protocol):
    """One solver at one tolerance."""

    @property
    def solver(self) -> str:
        """Its name."""
        ...

    @property
    def tolerance(self) -> float:
        """Asked for."""
        ...

    @property
    def end_m(self) -> float:
        """Got."""
        ...


def draw_graze(steps: Steps, points: Sequence[Point]) -> Figure:
    """Depth of the cell against time with the ends of steps; error against tolerance."""
    figure, (left, right) = panels(
        "A corner clips a cell, and DOP853 steps over it",
        "elliptic  ·  left: on the supports before the graze; right: error after 2 s",
        widths_in=(4.9, 4.3),
        height_in=3.4,
    )
    _draw_depth(left, steps)
    _draw_errors(right, points)
    return figure


def _draw_depth(axes: Axes, steps: Steps) -> None:
    time, depth = steps.course[0], 1e3 * steps.course[1]
    top = float(depth.max())
    axes.axhline(0.0, color="#8b95a1", lw=0.8)
    axes.fill_between(time, 0.0, depth, where=depth > 0.0, color=LOST, alpha=0.35, lw=0)
    axes.plot(time, depth, color=INK, lw=1.4)
    axes.annotate(
        "below the parcel: carries load",
        (float(time[np.argmax(depth)]), 0.4 * top),
        xytext=(24, 8),
        textcoords="offset points",
        color=LOST,
        fontsize=8,
        va="center",
        arrowprops={"arrowstyle": "-", "color": LOST, "lw": 0.8},
    )
    axes.set_ylim(_DEEPEST * top, _HIGHEST * top)
    axes.set_yticks([-2.0, -1.0, 0.0, 1.0])
    axes.set_xlim(float(time[0]) - 0.001, float(time[-1]))
    for number, (tolerance, ends) in enumerate(steps.ends.items()):
        _draw_step(axes, tolerance, ends[0, :2], (2.0 + 1.6 * number) * top, colour(number))
    axes.set_xlabel("time (s)")
    axes.set_ylabel("depth of the cell inside the footprint (mm)")


def _draw_step(axes: Axes, tolerance: float, ends: Floats, level: float, shade: str) -> None:
    """One step of DOP853 from end to end; with an arrow where it goes on beyond the view."""
    edge = axes.get_xlim()[1]
    axes.plot(ends[0], level, "|", ms=12, mew=2.0, color=shade)
    head = "-|>" if ends[1] > edge else "-"
    axes.annotate(
        "",
        (min(float(ends[1]), edge), level),
        (float(ends[0]), level),
        arrowprops={"arrowstyle": head, "color": shade, "lw": 1.6, "shrinkA": 0, "shrinkB": 0},
    )
    if ends[1] <= edge:
        axes.plot(ends[1], level, "|", ms=12, mew=2.0, color=shade)
    axes.annotate(
        f"DOP853, {power(tolerance)}: first step ends at {ends[1]:.4f} s",
        (float(ends[0]), level),
        xytext=(5, 6),
        textcoords="offset points",
        color=shade,
        fontsize=8,
    )


def _draw_errors(axes: Axes, points: Sequence[Point]) -> None:
    solvers = list(dict.fromkeys(point.solver for point in points))
    asked = np.array(sorted({point.tolerance for point in points}))
    axes.plot(asked, asked, color="#8fa0b2", lw=1.0, ls=(0, (4, 3)), label="as asked")
    for number, solver in enumerate(solvers):
        own = [point for point in points if point.solver == solver]
        axes.plot(
            [point.tolerance for point in own],
            [point.end_m for point in own],
            "o-",
            ms=4,
            lw=1.4,
            color=INK if solver == "exact" else colour(number - 1),
            label=solver if solver == "exact" else f"SciPy {solver}",
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.invert_xaxis()
    axes.set_xlabel("tolerance")
    axes.set_ylabel("error (m)")
    axes.legend(frameon=False, fontsize=7.5, loc="lower left")
