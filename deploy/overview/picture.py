"""The picture of a run: the overhead view and, beside it, x, y and angle against time."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from deploy.picture import DPI, draw_heading, write_picture
from deploy.track import Track
from deploy.words import counted

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deploy.recordings.replay import Recording

FILE_NAME = "overview.png"
_WIDE = 2.0
"""A view this many times as wide as high has its panels below it."""
_HEAD, _FOOT, _MARGIN, _EDGE, _GAP, _TEXT_LEFT = 0.95, 0.62, 0.85, 0.35, 1.0, 0.35
"""Space around the view, inches."""
_Box = tuple[float, float, float, float]


def draw_overview(run: Recording | Track, path: str | Path) -> None:
    """Draw a run, without a display; the file is written whole or not at all.

    Args:
        run: A recording, whole or cut, or the track of a simulation.
        path: The file to write, a PNG, SVG or PDF by its suffix.

    Raises:
        DeployError: It can't be written.
    """
    track = run if isinstance(run, Track) else run.track()
    write_picture(lambda: _figure(track), path)


def _figure(track: Track) -> Figure:
    from matplotlib.figure import Figure

    from deploy.overview.scenery import draw_map, extent
    from deploy.overview.times import draw_times

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
    if panels:
        draw_times(panels, track, stacked=stacked)
        if stacked:
            figure.align_ylabels(panels)
    draw_heading(figure, track.title or track.scene, _subtitle(track), _TEXT_LEFT)
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
    """The same for a wide array: the panels in a row under the view."""
    width, panel = 11.0, 2.4
    height = max(width / ratio, 0.8)
    lift = _FOOT + (panel + _FOOT if timed else 0.0)
    boxes = [(_MARGIN, lift, width, height)]
    if timed:
        each = (width - 2 * _GAP) / 3
        boxes += [(_MARGIN + column * (each + _GAP), _FOOT, each, panel) for column in range(3)]
    return _MARGIN + width + _EDGE, _HEAD + height + lift, boxes


def _subtitle(track: Track) -> str:
    parts = [
        track.scene,
        counted(len(track.positions_m), "cell"),
        counted(len(track.footprints_m), "parcel"),
    ]
    parts.append(f"{track.time_s[-1]:.4g} s" if len(track.time_s) else "no ticks")
    parts.append("recording cut" if track.status is None else track.status)
    return "  ·  ".join(parts)
