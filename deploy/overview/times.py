"""The panels beside the overhead view: x, y and angle against time."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from deploy.faults.telling import marks as marks_of
from deploy.overview.scenery import LABEL, LOST, colour, incidents
from deploy.track import Track

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes

QUANTITIES = ("x (m)", "y (m)", "θ (rad)")
_LEAST_SPAN = 1e-3
"""No panel shows less than a millimetre or a milliradian: below that a line at rest would look like motion."""
_POINTS = 6000
_LABELS = 5


def draw_times(panels: Sequence[Axes], track: Track, *, stacked: bool) -> None:
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


def _mark(axes: Axes, track: Track, *, labelled: bool) -> None:
    """A dashed line at each outcome and each fault; words on the first few."""
    marks = [(time_s, words) for time_s, words, _ in incidents(track)]
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
