"""The picture of one of the paper's simulations: the way, x and y beside the closed form, the angle."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from deploy.accuracy.evidence.drawing import GRID
from deploy.overview.scenery import INK, colour, draw_map
from deploy.picture import DPI, draw_heading

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from deploy.track import Track
    from plant.orientations import Orientation
    from plant.wheels import Floats

_WIDTH, _HEIGHT, _MAP = 11.4, 5.35, 3.85
"""Of the page and of the square view at its left, inches."""


def draw_scene(
    track: Track, closed_m: Sequence[Floats | None], stable: Sequence[Orientation], subtitle: str
) -> Figure:
    """Draw one simulation.

    Args:
        track: its course.
        closed_m: x and y in closed form at the track's times; None where there is none.
        stable: angles and intervals that attract.
        subtitle: what was run.
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, _HEIGHT), dpi=DPI, facecolor="white")
    view = figure.add_axes((0.72 / _WIDTH, 0.55 / _HEIGHT, _MAP / _WIDTH, _MAP / _HEIGHT))
    draw_map(view, track)
    view.set_xticks(np.arange(-1.0, 1.01, 0.5))
    view.set_yticks(np.arange(-1.0, 1.01, 0.5))
    each = (_MAP - 0.2) / 2
    left, across = 5.6, 5.45
    way, turn = (
        figure.add_axes((left / _WIDTH, low / _HEIGHT, across / _WIDTH, each / _HEIGHT))
        for low in (0.55 + each + 0.2, 0.55)
    )
    _draw_way(way, track, closed_m)
    _draw_turn(turn, track, stable)
    for axes in (way, turn):
        axes.grid(visible=True, color=GRID, lw=0.7)
        axes.set_axisbelow(True)
        axes.set_xlim(track.time_s[0], track.time_s[-1])
    way.tick_params(labelbottom=False)
    turn.set_xlabel("time (s)")
    figure.align_ylabels([way, turn])
    draw_heading(figure, track.title, subtitle, 0.35)
    return figure


def _draw_way(axes: Axes, track: Track, closed_m: Sequence[Floats | None]) -> None:
    axes.axhline(0.0, color="#8b95a1", lw=0.8)
    for axis, name in enumerate("xy"):
        axes.plot(track.time_s, track.parcels[:, 0, axis], color=colour(axis), lw=1.7, label=name)
        closed = closed_m[axis]
        if closed is not None:
            label = "closed form" if axis == 1 else None
            axes.plot(track.time_s, closed, color=INK, lw=1.1, ls=(0, (2, 3)), label=label)
    axes.set_ylabel("x, y (m)")
    axes.legend(frameon=False, fontsize=8, loc="upper right")


def _draw_turn(axes: Axes, track: Track, stable: Sequence[Orientation]) -> None:
    angle = np.degrees(track.parcels[:, 0, 2])
    axes.plot(track.time_s, angle, color=colour(2), lw=1.7)
    low, high = float(angle.min()), float(angle.max())
    room = 0.12 * (high - low) + 1.0
    axes.set_ylim(low - room, high + room)
    for one in stable:
        for turn in (-360.0, 0.0):
            ends = np.degrees((one.low_rad, one.high_rad)) + turn
            if ends[1] < low - room or ends[0] > high + room:
                continue
            axes.axhspan(max(float(ends[0]), low - room), float(ends[1]), color=colour(1), alpha=0.22, lw=0)
            axes.annotate(
                "attracting",
                (0.012, float(np.mean(np.clip(ends, low - room, high + room)))),
                xycoords=("axes fraction", "data"),
                ha="left",
                va="center",
                fontsize=7.5,
                color=colour(1),
            )
    axes.set_ylabel("angle (degrees)")
