"""Plots of a run as panels of curves: over time, in phase planes, and of the wheels' forces."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deploy.plots.overview import subtitle_of
from deploy.plots.theme import DPI, draw_heading
from deploy.util.colours import colour

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deploy.recordings.recording import Recording
    from deploy.recordings.trace import RunTrace

Floats = NDArray[np.float64]
INSTANTS = 400
"""Most instants at which forces are computed."""
_POINTS = 6000
_MANY = 6
_HEAD_IN, _FOOT_IN, _LEFT_IN, _RIGHT_IN, _GAP_IN = 0.95, 0.85, 0.95, 0.3, 0.95
_PANEL_IN = (3.2, 2.4)


class Panel(NamedTuple):
    """One panel: a curve a parcel.

    Attributes:
        across: Values along x of a parcel, ``(T,)``.
        up: Values along y of a parcel, ``(T,)``.
        across_label: Name and unit along x.
        up_label: Name and unit along y.
    """

    across: Callable[[int], Floats]
    up: Callable[[int], Floats]
    across_label: str
    up_label: str


_STATES = ("x (m)", "y (m)", "θ (rad)", "x velocity (m/s)", "y velocity (m/s)", "ω (rad/s)")


def time_figure(recording: Recording) -> Figure:
    """Draw position, angle and their rates against time."""
    track = recording.run_trace()
    rows = _thinned(len(track.time_s))
    panels = [
        Panel(_at(track.time_s[rows]), _state(track, rows, column), "time (s)", name)
        for column, name in enumerate(_STATES)
    ]
    return panel_figure(track, panels, "motion over time", columns=3)


def phase_figure(recording: Recording) -> Figure:
    """Draw velocity against position, along x, along y and in rotation; a ring marks the start, a dot the end."""
    track = recording.run_trace()
    rows = _thinned(len(track.time_s))
    panels = [
        Panel(
            _state(track, rows, column), _state(track, rows, column + 3), _STATES[column], _STATES[column + 3]
        )
        for column in range(3)
    ]
    return panel_figure(track, panels, "phase planes: ring = start, dot = end", columns=3, ends=True)


def torque_figure(recording: Recording) -> Figure:
    """Draw force and torque of the wheels on each parcel against time, about its centre of mass."""
    track = recording.run_trace()
    # at the first instant the wheels stand: no drive has acted yet
    rows = np.unique(np.linspace(1, len(track.time_s) - 1, INSTANTS).astype(np.int64))
    rows = rows[rows > 0] if len(track.time_s) > 1 else rows[:0]
    found = np.full((len(rows), len(track.footprints_m), 3), np.nan)
    for place, row in enumerate(rows.tolist()):
        forces = recording.tractions(row)
        for one in forces.parcels:
            lever = track.positions_m[one.cells] - track.parcels[row, one.parcel, :2]
            found[place, one.parcel, :2] = one.traction_n.sum(axis=0)
            found[place, one.parcel, 2] = np.sum(
                lever[:, 0] * one.traction_n[:, 1] - lever[:, 1] * one.traction_n[:, 0]
            )
    labels = ("force along x (N)", "force along y (N)", "torque (N m)")
    panels = [
        Panel(_at(track.time_s[rows]), _column(found, column), "time (s)", name)
        for column, name in enumerate(labels)
    ]
    note = "wheels' force and torque; gaps: a wheel sticks"
    return panel_figure(
        track,
        panels,
        note + "".join(f", {name} not included" for name in recording.left_out_effects),
        columns=3,
    )


def panel_figure(
    track: RunTrace, panels: Sequence[Panel], note: str, *, columns: int, ends: bool = False
) -> Figure:
    """Draw panels side by side, with the heading of a run and the parcels' numbers.

    Args:
        track: Run of the heading and the parcels.
        panels: The panels.
        note: Meaning of the panels, for the line under the title.
        columns: Panels in a row.
        ends: Whether the ends of the curves are marked.
    """
    from matplotlib.figure import Figure

    rows = -(-len(panels) // columns)
    width = _LEFT_IN + columns * _PANEL_IN[0] + (columns - 1) * _GAP_IN + _RIGHT_IN
    height = _HEAD_IN + rows * _PANEL_IN[1] + (rows - 1) * 0.75 + _FOOT_IN
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    parcels = len(track.footprints_m)
    for number, panel in enumerate(panels):
        row, column = divmod(number, columns)
        x = _LEFT_IN + column * (_PANEL_IN[0] + _GAP_IN)
        y = height - _HEAD_IN - (row + 1) * _PANEL_IN[1] - row * 0.75
        axes = figure.add_axes((x / width, y / height, _PANEL_IN[0] / width, _PANEL_IN[1] / height))
        for parcel in range(parcels):
            _curve(axes, panel.across(parcel), panel.up(parcel), parcel, many=parcels > _MANY, ends=ends)
        axes.set_xlabel(panel.across_label)
        axes.set_ylabel(panel.up_label)
        axes.grid(visible=True, color="#e3e7ec", lw=0.7)
        axes.set_axisbelow(True)
        axes.ticklabel_format(useOffset=False)
        axes.locator_params(axis="x", nbins=6)
        if not parcels:
            axes.text(0.5, 0.5, "no parcel", transform=axes.transAxes, ha="center", color="#5b6570")
            axes.set(xticks=[], yticks=[])
    if 1 < parcels <= 12:
        _name_parcels(figure, parcels)
    draw_heading(figure, track.title or track.scene, f"{subtitle_of(track)}  ·  {note}", 0.35)
    return figure


def _curve(axes: Any, across: Floats, up: Floats, parcel: int, *, many: bool, ends: bool) -> None:
    shade = colour(parcel)
    axes.plot(across, up, color=shade, lw=0.8 if many else 1.5, alpha=0.7 if many else 1.0)
    there = np.flatnonzero(np.isfinite(across) & np.isfinite(up))
    if ends and len(there):
        size = 3 if many else 4.5
        axes.plot(across[there[0]], up[there[0]], "o", ms=size, mfc="white", mec=shade, zorder=5)
        axes.plot(across[there[-1]], up[there[-1]], "o", ms=size, color=shade, zorder=5)


def _name_parcels(figure: Figure, parcels: int) -> None:
    from matplotlib.lines import Line2D

    handles = [Line2D([], [], color=colour(i), lw=1.6, label=f"parcel {i}") for i in range(parcels)]
    figure.legend(
        handles=handles,
        loc="lower left",
        ncols=min(parcels, 8),
        frameon=False,
        fontsize=8,
        labelcolor="#5b6570",
    )


def _thinned(instants: int) -> NDArray[np.int64]:
    """Rows to draw: far more points than pixels change nothing; the last one always stays."""
    step = max(1, instants // _POINTS)
    rows = np.arange(0, instants, step, dtype=np.int64)
    return np.unique(np.append(rows, instants - 1)) if instants else rows


def _at(values: Floats) -> Callable[[int], Floats]:
    return lambda _: values


def _state(track: RunTrace, rows: NDArray[np.int64], column: int) -> Callable[[int], Floats]:
    return lambda parcel: track.parcels[rows, parcel, column]


def _column(values: Floats, column: int) -> Callable[[int], Floats]:
    return lambda parcel: values[:, parcel, column]
