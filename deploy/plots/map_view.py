"""Map view: array, wheel velocities, the parcels' paths and outlines."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deploy.faults.records import OUT, lost_for_good, out_of_array
from deploy.plots.arrows import ArrowGrid, draw_arrows
from deploy.recordings.trace import RunTrace
from deploy.util.colours import colour

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.collections import LineCollection, PolyCollection

INK = "#22272e"
LOST = "#c1121f"
LABEL: Any = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8}
"""Behind words that lines may cross."""
CELL = "#eceff3"
_CELL_LARGE = "#f3f5f8"
ARROW = "#7d8a9a"
EXIT = "#4b7a3f"
PULLED = "#8a5a00"
RAIL = "#3a424d"

_SQUARES = 2500
"""Up to this many cells each is a square of its own; beyond, gaps would be under a pixel."""
_OUTLINES = 9
"""Outlines of a parcel on its way, start and end included, for few parcels."""
_FEW = 6
NUMBERED = 64
"""Up to this many parcels have their number in the map."""
_NARROW = 0.2
"""A view this many times as wide as high has room for one number below it."""


def extent(track: RunTrace) -> tuple[float, float, float, float]:
    """Left, right, bottom and top of the view: the array, and where parcels went, within reason."""
    half = track.pitch_m / 2
    low, high = track.positions_m.min(axis=0) - half, track.positions_m.max(axis=0) + half
    reach = 0.5 * float((high - low).max())
    corners = [low, high]
    for parcel, footprint in enumerate(track.footprints_m):
        centres = track.parcels[:, parcel, :2]
        centres = centres[np.isfinite(centres).all(axis=1)]
        if len(centres):
            radius = float(np.hypot(footprint[:, 0], footprint[:, 1]).max())
            corners += [centres.min(axis=0) - radius, centres.max(axis=0) + radius]
    # An unstable run may fling a parcel anywhere: the array must stay in sight.
    bounds = np.clip(np.array(corners), low - reach, high + reach)
    left, bottom = bounds.min(axis=0) - half
    right, top = bounds.max(axis=0) + half
    return float(left), float(right), float(bottom), float(top)


def draw_map(axes: Axes, track: RunTrace) -> None:
    """Draw the overhead view, metres along both axes."""
    draw_ground(axes, track)
    _draw_arrows(axes, track)
    _draw_faults(axes, track)
    for parcel in range(len(track.footprints_m)):
        _draw_parcel(axes, track, parcel)
    _draw_incidents(axes, track)


def draw_ground(axes: Axes, track: RunTrace) -> PolyCollection:
    """Draw what does not change in a run: cells, exits, rails and the axes' labels. Returns the cells."""
    left, right, bottom, top = extent(track)
    axes.set_aspect("equal")
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    cells = _draw_cells(axes, track)
    draw_surroundings(axes, track)
    if right - left < _NARROW * (top - bottom):
        axes.set_xticks([round(0.5 * (left + right), 3)])
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    return cells


def draw_surroundings(axes: Axes, track: RunTrace) -> None:
    """Draw the exits with their names, and the guide rails."""
    _draw_exits(axes, track)
    for rail in track.rails_m:
        axes.fill(*np.array(rail).T, fc=RAIL, ec=RAIL, lw=2.4, joinstyle="round", zorder=2.8)


def square_corners(centres: NDArray[np.float64], side: float) -> NDArray[np.float64]:
    """``(n, 4, 2)`` corners of squares."""
    corners = 0.5 * side * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return centres[:, None, :] + corners


def _draw_cells(axes: Axes, track: RunTrace) -> PolyCollection:
    from matplotlib.collections import PolyCollection

    large = len(track.positions_m) > _SQUARES
    squares = square_corners(track.positions_m, track.pitch_m * (1.0 if large else 0.92))
    cells = PolyCollection(
        list(squares),
        facecolors=_CELL_LARGE if large else CELL,
        edgecolors="none",
        antialiaseds=not large,
        zorder=1,
    )
    axes.add_collection(cells, autolim=False)
    return cells


def _draw_arrows(axes: Axes, track: RunTrace) -> None:
    """Wheel velocities, of every k-th cell each way where the array is large."""
    if track.wheel_speeds is None:
        return
    grid = ArrowGrid.of(track.cells, track.pitch_m)
    speed = np.hypot(*track.wheel_speeds.T)
    moving = grid.shown & np.isfinite(speed) & (speed > 0)
    if moving.any():
        fastest = float(speed[moving].max())
        draw_arrows(axes, grid, track.positions_m[moving], track.wheel_speeds[moving], fastest, ARROW)


def affected_cells(track: RunTrace) -> set[tuple[int, int]]:
    """Return the cells affected by a fault with begin and end, except cells that were out of the array."""
    return {
        (row, column)
        for fault in track.faults
        if "phase" in fault and fault["kind"] not in OUT
        for row, column in fault["cells"]
    }


def _draw_faults(axes: Axes, track: RunTrace) -> None:
    """Mark affected cells: white and dashed for removed modules, a red rim for faults, a cross for lost cells.

    A module that was added, for the first time or again, keeps its arrow. A module that is absent at the end has no
    arrow.
    """
    if not track.faults:
        return
    index = {(row, column): i for i, (row, column) in enumerate(track.cells)}
    out = out_of_array(track.faults)
    _draw_squares(
        axes,
        track,
        [index[cell] for cell in out if cell in index],
        edgecolors=PULLED,
        linestyles=(0, (2, 1.5)),
    )
    away = [index[cell] for cell, again_s in out.items() if again_s is None and cell in index]
    _draw_squares(axes, track, away, facecolors="white", edgecolors=PULLED, linestyles=(0, (2, 1.5)))
    affected = [index[cell] for cell in affected_cells(track) if cell in index]
    _draw_squares(axes, track, affected, edgecolors=LOST)
    lost = [index[cell] for cell in lost_for_good(track.faults) if cell in index]
    _draw_squares(axes, track, lost, facecolors="#fbd9d3", edgecolors=LOST)
    draw_crosses(axes, track, lost)


def _draw_squares(
    axes: Axes, track: RunTrace, cells: list[int], *, facecolors: str = "none", **style: Any
) -> None:
    from matplotlib.collections import PolyCollection

    if not cells:
        return
    squares = list(square_corners(track.positions_m[sorted(cells)], 0.92 * track.pitch_m))
    axes.add_collection(
        PolyCollection(squares, facecolors=facecolors, linewidths=0.8, zorder=2.5, **style), autolim=False
    )


def white_rim(width: float) -> list[Any]:
    """Return the effects of an outline of some width by which it is seen on cells of the same colour, too."""
    from matplotlib.patheffects import Normal, Stroke

    return [Stroke(linewidth=width + 2.0, foreground="white"), Normal()]


def draw_crosses(axes: Axes, track: RunTrace, cells: Sequence[int]) -> LineCollection:
    """Draw a cross on each of some cells, given by index. Returns the crosses."""
    from matplotlib.collections import LineCollection

    strokes = LineCollection(cross_strokes(track, cells), colors=LOST, linewidths=1.1, zorder=3.2)
    axes.add_collection(strokes, autolim=False)
    return strokes


def cross_strokes(track: RunTrace, cells: Sequence[int]) -> list[NDArray[np.float64]]:
    """Return the two strokes of a cross on each of some cells, ``(2, 2)`` each."""
    crosses = square_corners(track.positions_m[list(cells)], 0.5 * track.pitch_m)
    return list(np.concatenate([crosses[:, [0, 2]], crosses[:, [1, 3]]]))


def _draw_exits(axes: Axes, track: RunTrace) -> None:
    """Each exit with its name, at whichever of its corners lies farthest up and to the right."""
    for name, corners in track.exits:
        axes.fill(*corners.T, fc="none", ec=EXIT, hatch="////", lw=0, alpha=0.3, zorder=1.5)
        axes.fill(*corners.T, fill=False, ec=EXIT, lw=1.2, ls=(0, (4, 2)), zorder=2.7)
        x, y = corners[np.argmax(corners.sum(axis=1))]
        axes.annotate(
            name,
            (x, y),
            xytext=(-3, -4),
            textcoords="offset points",
            ha="right",
            va="top",
            color=EXIT,
            fontsize=8,
            fontweight="bold",
            bbox=LABEL,
            zorder=7,
            parse_math=False,
        )


def outline(footprint: NDArray[np.float64], state: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners of a footprint at a pose."""
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    turn = np.array([[cosine, sine], [-sine, cosine]])
    return footprint @ turn + state[:2]


def _draw_parcel(axes: Axes, track: RunTrace, parcel: int) -> None:
    """Path, outlines at regular times growing more solid, and the last with its front where it is still there."""
    from matplotlib.patheffects import withStroke

    states = track.parcels[:, parcel]
    whole = np.flatnonzero(np.isfinite(states).all(axis=1))
    if not len(whole):
        return
    footprint, shade = track.footprints_m[parcel], colour(parcel)
    few = len(track.footprints_m) <= _FEW
    path = states[whole]
    axes.plot(
        path[:, 0], path[:, 1], color=shade, lw=1.6 if few else 0.8, alpha=0.9 if few else 0.5, zorder=4
    )
    axes.plot(path[:1, 0], path[:1, 1], "o", ms=4 if few else 2.5, mfc="white", mec=shade, zorder=5)
    times = np.linspace(track.time_s[whole[0]], track.time_s[whole[-1]], _OUTLINES if few else 2)
    passed = np.unique(np.searchsorted(track.time_s[whole], times).clip(max=len(whole) - 1))[:-1]
    for place, step in enumerate(passed):
        corners = outline(footprint, path[step])
        weight = 0.22 + 0.5 * place / max(len(passed), 1)
        axes.fill(*corners.T, fill=False, ec=shade, lw=1.0, alpha=weight, zorder=3)
    last = path[-1]
    corners = outline(footprint, last)
    if parcel in _left(track):
        axes.fill(*corners.T, fill=False, ec=shade, lw=1.0, alpha=0.6, zorder=3)
        axes.plot(*last[:2], ">", ms=4 if few else 3, color=shade, zorder=6)
        return
    axes.fill(*corners.T, fc=shade, ec="none", alpha=0.22, zorder=3.5)
    axes.fill(*corners.T, fill=False, ec=shade, lw=2.0 if few else 1.3, joinstyle="round", zorder=5)
    front = np.array([[0.0, 0.0], [float(footprint[:, 0].max()), 0.0]])
    axes.plot(*outline(front, last).T, color=shade, lw=1.6 if few else 1.0, zorder=5)
    axes.plot(*last[:2], "o", ms=4 if few else 2.5, color=shade, zorder=6)
    if 1 < len(track.footprints_m) <= NUMBERED:
        axes.annotate(
            str(parcel),
            (last[0], last[1]),
            xytext=(5, 5) if few else (2, 2),
            textcoords="offset points",
            color=INK,
            fontsize=9 if few else 6.5,
            fontweight="bold",
            path_effects=[withStroke(linewidth=2.5, foreground="white")],
            zorder=7,
        )


def _left(track: RunTrace) -> set[int]:
    """Parcels that left through an exit."""
    return {event["parcel"] for event in track.events if event["kind"] == "left"}


def event_annotations(track: RunTrace) -> list[tuple[float, str, int | None]]:
    """Return time, label and parcel of annotated events: outcomes, without changes of support."""
    return [
        (float(event["time_s"]), str(event["kind"]).replace("_", " "), event.get("parcel"))
        for event in track.events
        if event["kind"] in ("tipped", "off_array") or "overlap" in event["kind"]
    ]


def _draw_incidents(axes: Axes, track: RunTrace) -> None:
    for time_s, words, parcel in event_annotations(track):
        if parcel is None or not len(track.time_s):
            continue
        step = min(int(np.searchsorted(track.time_s, time_s)), len(track.time_s) - 1)
        x, y = track.parcels[step, parcel, :2]
        if np.isfinite(x) and np.isfinite(y):
            axes.plot(x, y, "^", ms=8, mfc="white", mec=LOST, mew=1.4, zorder=8)
            axes.annotate(
                words,
                (x, y),
                xytext=(7, -10),
                textcoords="offset points",
                color=LOST,
                fontsize=8,
                bbox=LABEL,
                zorder=8,
            )
