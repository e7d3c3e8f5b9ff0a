"""Overview plot of a run: the map view, with x, y and angle against time beside it."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deploy.faults.records import plot_marks as marks_of
from deploy.plots.map_view import LABEL, LOST, event_annotations
from deploy.plots.theme import DPI, draw_heading, write_picture
from deploy.recordings.trace import RunTrace
from deploy.util.colours import colour
from deploy.util.formatting import plural

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from deploy.recordings.recording import Recording


QUANTITIES = ("x (m)", "y (m)", "θ (rad)")
_LEAST_SPAN = 1e-3
"""No panel shows less than a millimetre or a milliradian: below that a line at rest would look like motion."""
_POINTS = 6000
_LABELS = 5


def draw_times(panels: Sequence[Axes], track: RunTrace, *, stacked: bool) -> None:
    """Draw one quantity a panel, a line a parcel, and a mark where something happened.

    Args:
        panels: Three axes, for x, y and the angle.
        track: The run.
        stacked: Whether the panels stand above one another and share the labels of the lowest.
    """
    # Far more points than pixels cost time and change nothing; the last one always stays.
    step = max(1, len(track.time_s) // _POINTS)
    rows = np.unique(np.append(np.arange(0, len(track.time_s), step), len(track.time_s) - 1))
    many = len(track.footprints_m) > 6
    for column, (axes, name) in enumerate(zip(panels, QUANTITIES, strict=True)):
        for parcel in range(len(track.footprints_m)):
            axes.plot(
                track.time_s[rows],
                track.parcels[rows, parcel, column],
                color=colour(parcel),
                lw=0.8 if many else 1.5,
                alpha=0.7 if many else 1.0,
            )
        axes.set_ylabel(name)
        axes.grid(visible=True, color="#e3e7ec", lw=0.7)
        axes.set_axisbelow(True)
        axes.margins(x=0)
        if len(track.time_s) > 1:  # all of it, also where no parcel is there
            axes.set_xlim(track.time_s[0], track.time_s[-1])
        low, high = axes.get_ylim()
        if high - low < _LEAST_SPAN:
            middle = 0.5 * (low + high)
            axes.set_ylim(middle - 0.5 * _LEAST_SPAN, middle + 0.5 * _LEAST_SPAN)
        axes.ticklabel_format(axis="y", useOffset=False)
        if stacked and column < 2:
            axes.tick_params(labelbottom=False)
        else:
            axes.set_xlabel("time (s)")
        _mark(axes, track, labelled=column == 0)


def _mark(axes: Axes, track: RunTrace, *, labelled: bool) -> None:
    """A dashed line at each outcome and each fault; words on the first few."""
    marks = [(time_s, words) for time_s, words, _ in event_annotations(track)]
    marks += marks_of(track.faults)
    begin, end = axes.get_xlim()
    for place, (time_s, words) in enumerate(sorted(marks)):
        axes.axvline(time_s, color=LOST, lw=0.9, ls=(0, (4, 3)), alpha=0.8)
        if labelled and place < _LABELS:
            late = time_s > begin + 0.6 * (end - begin)
            axes.annotate(
                words,
                (time_s, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(-4 if late else 4, -9 - 11 * place),
                textcoords="offset points",
                ha="right" if late else "left",
                color=LOST,
                fontsize=7.5,
                bbox=LABEL,
            )


FILE_NAME = "overview.png"
_WIDE = 2.0
"""A view this many times as wide as high has its panels below it."""
_HEAD, _FOOT, _MARGIN, _EDGE, _GAP, _TEXT_LEFT = 0.95, 0.72, 0.85, 0.35, 1.0, 0.35
"""Space around the view, inches."""
_Box = tuple[float, float, float, float]


def draw_overview(run: Recording | RunTrace, path: str | Path) -> None:
    """Draw a run, without a display; the file is written whole or not at all.

    Args:
        run: A recording, whole or cut, or the track of a simulation.
        path: The file to write, a PNG, SVG or PDF by its suffix.

    Raises:
        DeployError: It can't be written.
    """
    track = run if isinstance(run, RunTrace) else run.run_trace()
    write_picture(lambda: _figure(track), path)


def _figure(track: RunTrace) -> Figure:
    from matplotlib.figure import Figure

    from deploy.plots.legend import draw_legend
    from deploy.plots.map_view import draw_map, extent

    left, right, bottom, top = extent(track)
    timed = len(track.footprints_m) > 0 and len(track.time_s) > 0
    ratio = (right - left) / (top - bottom)
    stacked = ratio <= _WIDE
    width, height, boxes = (_beside if stacked else _below)(ratio, timed)
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    view, *panels = [
        figure.add_axes((x / width, y / height, across / width, up / height)) for x, y, across, up in boxes
    ]
    view.set_anchor("N")
    draw_map(view, track)
    draw_legend(view, track, above=not stacked)
    if panels:
        draw_times(panels, track, stacked=stacked)
        if stacked:
            figure.align_ylabels(panels)
    draw_heading(figure, track.title or track.scene, subtitle_of(track), _TEXT_LEFT)
    return figure


def _beside(ratio: float, timed: bool) -> tuple[float, float, list[_Box]]:
    """Width, height and boxes of a page with the view at the left and the panels stacked at the right."""
    tall, panel = 6.2, 4.2
    width = min(max(tall * ratio, 2.0), 8.0)
    height = min(max(width / ratio, 4.2), tall)  # the view's own where it fills its width: no blank below it
    boxes = [(_MARGIN, _FOOT, width, height)]
    page = _MARGIN + width + _EDGE
    if timed:
        x, each = _MARGIN + width + _GAP, (height - 0.3) / 3
        boxes += [(x, _FOOT + row * (each + 0.15), panel, each) for row in (2, 1, 0)]
        page += _GAP + panel
    return max(page, 6.0), _HEAD + height + _FOOT, boxes


def _below(ratio: float, timed: bool) -> tuple[float, float, list[_Box]]:
    """Lay out a wide array: the panels in a row under the view."""
    width, panel = 11.0, 2.4
    height = max(width / ratio, 0.8)
    lift = _FOOT + (panel + _FOOT if timed else 0.0)
    boxes = [(_MARGIN, lift, width, height)]
    if timed:
        each = (width - 2 * _GAP) / 3
        boxes += [(_MARGIN + column * (each + _GAP), _FOOT, each, panel) for column in range(3)]
    return _MARGIN + width + _EDGE, _HEAD + height + lift, boxes


def subtitle_of(track: RunTrace) -> str:
    """Return the facts of a run for the line under a plot's title."""
    parts = [
        *([track.scene] if track.title else []),  # else it is the title
        plural(len(track.positions_m), "cell"),
        plural(len(track.footprints_m), "parcel"),
    ]
    parts.append(f"{track.time_s[-1]:.4g} s" if len(track.time_s) else "no ticks")
    parts.append("recording cut" if track.status is None else track.status)
    return "  ·  ".join(parts)
