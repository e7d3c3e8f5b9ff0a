"""Legend of the map view: each mark that occurs, with its meaning."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from deploy.faults.records import lost_for_good, out_of_array
from deploy.plots.map_view import EXIT, LOST, PULLED, RAIL, affected_cells, event_annotations

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.lines import Line2D

    from deploy.recordings.trace import RunTrace

_GREY = "#5b6570"
_ENTRY_IN = 1.15
"""Width of a legend's entry, inches."""
_DROP_IN = 0.48
"""Distance of a legend below the axes, inches: room for the labels of x."""


def draw_legend(axes: Axes, track: RunTrace, *, above: bool) -> None:
    """Draw the legend of a map beside its axes.

    Args:
        axes: Axes of the map.
        track: Run of the map.
        above: Whether it stands above the axes instead of below the label of x.
    """
    handles = _handles(track)
    if not handles:
        return
    figure: Any = axes.get_figure()
    box: Any = axes.get_position()
    columns = max(1, min(len(handles), int(box.width * figure.get_figwidth() / _ENTRY_IN)))
    drop = -_DROP_IN / (box.height * figure.get_figheight())
    place: dict[str, Any] = (
        {"loc": "lower left", "bbox_to_anchor": (0.0, 1.0)}
        if above
        else {"loc": "upper left", "bbox_to_anchor": (0.0, drop)}
    )
    axes.legend(
        handles=handles,
        ncols=columns,
        frameon=False,
        fontsize=7.5,
        labelcolor=_GREY,
        handlelength=1.2,
        handletextpad=0.5,
        columnspacing=1.2,
        borderpad=0.1,
        borderaxespad=0.0,
        **place,
    )


def _handles(track: RunTrace) -> list[Line2D]:
    """One handle for each kind of mark in the map."""
    import numpy as np

    found: list[Line2D] = []
    if track.footprints_m and np.isfinite(track.parcels).all(axis=2).any():
        found += [_mark("o", "start", mfc="white"), _mark("o", "end; line: front")]
    if any(event["kind"] == "left" for event in track.events):
        found.append(_mark(">", "left by an exit"))
    if event_annotations(track):
        found.append(_mark("^", "incident", mfc="white", mec=LOST))
    if lost_for_good(track.faults):
        found.append(_mark("x", "cell lost", mec=LOST))
    if affected_cells(track):
        found.append(_mark("s", "cell with a fault", mfc="none", mec=LOST))
    if out_of_array(track.faults):
        found.append(_line("module pulled", PULLED, (0, (2, 1.5))))
    if track.exits:
        found.append(_line("exit", EXIT, (0, (4, 2))))
    if track.rails_m:
        found.append(_line("rail", RAIL, "-", 2.4))
    return found


def _mark(marker: str, label: str, mfc: str = _GREY, mec: str = _GREY) -> Line2D:
    from matplotlib.lines import Line2D

    return Line2D([], [], ls="", marker=marker, ms=4.5, mfc=mfc, mec=mec, label=label)


def _line(label: str, colour: str, style: Any, width: float = 1.2) -> Line2D:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, ls=style, lw=width, label=label)
