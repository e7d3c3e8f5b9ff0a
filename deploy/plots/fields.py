"""Plots of all cells at one instant: loads and tractions, and speeds of the wheels."""

# pyright: reportUnknownMemberType=false, reportUnknownArgumentType=false, reportUnknownVariableType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deploy.faults.fault_state import DEAD, FaultState
from deploy.plots.arrows import ArrowGrid, draw_arrows
from deploy.plots.cell_values import RegisterValues
from deploy.plots.map_view import (
    INK,
    LABEL,
    draw_crosses,
    draw_surroundings,
    extent,
    outline,
    square_corners,
    white_rim,
)
from deploy.plots.overview import subtitle_of
from deploy.plots.theme import DPI, draw_heading
from deploy.util.colours import colour

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deploy.recordings.recording import Recording
    from deploy.recordings.trace import RunTrace

Floats = NDArray[np.float64]
_COLOURS, _DARKEST = "YlGnBu", 0.6
"""Colour map, and the part of it that is used: arrows must be visible on the darkest cell."""
_EMPTY = "#eceff3"
_HEAD_IN, _FOOT_IN, _LEFT_IN, _RIGHT_IN, _BAR_IN = 1.05, 0.62, 0.85, 0.85, 0.16


def loads_figure(recording: Recording, instant: int) -> Figure:
    """Draw the load on each cell as its colour, and the traction of its wheels as an arrow."""
    forces = recording.tractions(instant)
    load = np.where(forces.load_n > 0.0, forces.load_n, np.nan)
    sticking = int(np.count_nonzero(forces.sticking))
    note = f"loads and tractions at {recording.time_s[instant]:.4g} s"
    if sticking:
        note += f"  ·  {sticking} wheels stick: no arrow"
    if recording.left_out_effects:
        note += f"  ·  not included: {', '.join(recording.left_out_effects)}"
    return _cells_figure(recording, instant, load, "load (N)", forces.traction_n, ("traction", "N"), note)


def field_figure(recording: Recording, instant: int, register: str | None = None) -> Figure:
    """Draw the wheels' velocity at each cell as an arrow, and its magnitude or a register as a colour.

    Args:
        recording: The recording.
        instant: Row of its instants.
        register: Register that colours the cells, as it was recorded last; None: the magnitude of the velocity does.

    Raises:
        InputError: The recording has no registers, or no such register.
    """
    velocity = recording.held_wheel_speeds.at(instant)
    note = f"wheels at {recording.time_s[instant]:.4g} s"
    if register is None:
        speed = np.hypot(velocity[:, 0], velocity[:, 1])
        return _cells_figure(
            recording, instant, speed, "wheel speed (m/s)", velocity, ("wheels", "m/s"), note
        )
    values = RegisterValues(recording, register)
    return _cells_figure(
        recording,
        instant,
        values.at(instant),
        values.label,
        velocity,
        ("wheels", "m/s"),
        f"{register} and {note}",
        values.limits(np.array([instant])),
    )


def _cells_figure(
    recording: Recording,
    instant: int,
    values: Floats,
    label: str,
    arrows: Floats,
    scale: tuple[str, str],
    note: str,
    limits: tuple[float, float] | None = None,
) -> Figure:
    """Draw a value of each cell as a colour with a bar, an arrow a cell, and the parcels' outlines.

    Args:
        recording: The recording.
        instant: Row of its instants.
        values: ``(n,)``; NaN is drawn as an empty cell.
        label: Name and unit of the values.
        arrows: ``(n, 2)``; NaN and zero are not drawn.
        scale: Meaning and unit of the arrows.
        note: Meaning of the plot, for the line under the title.
        limits: Values at the ends of the bar; None: zero and the greatest value.
    """
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    track = recording.run_trace()
    left, right, bottom, top = extent(track)
    ratio = (right - left) / (top - bottom)
    wide = min(max(6.2 * ratio, 3.0), 11.0)
    tall = min(max(wide / ratio, 1.0), 6.2)
    width, height = _LEFT_IN + wide + 0.2 + _BAR_IN + _RIGHT_IN, _HEAD_IN + tall + _FOOT_IN
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    axes = figure.add_axes((_LEFT_IN / width, _FOOT_IN / height, wide / width, tall / height))
    axes.set_aspect("equal", anchor="NW")
    axes.set_xlim(left, right)
    axes.set_ylim(bottom, top)
    fine = len(values) > 2500  # gaps would be under a pixel
    cells = PolyCollection(
        list(square_corners(track.positions_m, track.pitch_m * (1.0 if fine else 0.92))),
        array=np.ma.masked_invalid(values),
        cmap=cell_colours(),
        antialiaseds=not fine,
        edgecolors="none",
        zorder=1,
    )
    most = float(np.nanmax(values)) if np.isfinite(values).any() else 0.0
    cells.set_clim(*(limits or (0.0, most or 1.0)))
    axes.add_collection(cells, autolim=False)
    draw_surroundings(axes, track)
    _draw_arrows(axes, track, arrows, scale)
    state = FaultState(track.cells)
    state.add(track.faults)
    dead = np.flatnonzero(state.health(float(track.time_s[instant])) == DEAD)
    draw_crosses(axes, track, dead.tolist())
    if len(dead):
        note += "  ·  cross: dead or lost"
    _draw_parcels(axes, track, instant)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    x = _LEFT_IN + wide + 0.2
    bar = figure.add_axes((x / width, _FOOT_IN / height, _BAR_IN / width, tall / height))
    figure.colorbar(cells, cax=bar, label=label)
    draw_heading(figure, track.title or track.scene, f"{subtitle_of(track)}  ·  {note}", 0.35)
    return figure


def cell_colours() -> Any:
    """Return the colour map of cells, on whose darkest colour arrows are visible."""
    import matplotlib as mpl
    from matplotlib.colors import ListedColormap

    shades = mpl.colormaps[_COLOURS](np.linspace(0.0, _DARKEST, 256))
    return ListedColormap(shades).with_extremes(bad=_EMPTY)


def _draw_arrows(axes: Any, track: RunTrace, arrows: Floats, scale: tuple[str, str]) -> None:
    grid, size = ArrowGrid.of(track.cells, track.pitch_m), np.hypot(arrows[:, 0], arrows[:, 1])
    shown = grid.shown & np.isfinite(size) & (size > 0.0)
    if shown.any():
        longest = float(size[shown].max())
        draw_arrows(axes, grid, track.positions_m[shown], arrows[shown], longest, INK, scale, zorder=3)


def _draw_parcels(axes: Any, track: RunTrace, instant: int) -> None:
    many = len(track.footprints_m) > 12
    width = 1.2 if many else 2.0
    for parcel, footprint in enumerate(track.footprints_m):
        state = track.parcels[instant, parcel]
        if not np.isfinite(state).all():
            continue
        axes.fill(
            *outline(footprint, state).T,
            fill=False,
            ec=colour(parcel),
            lw=width,
            path_effects=white_rim(width),
            zorder=4,
        )
        if len(track.footprints_m) > 1:
            axes.text(
                state[0],
                state[1],
                str(parcel),
                ha="center",
                va="center",
                color=INK,
                fontsize=6.5 if many else 9,
                fontweight="bold",
                bbox=LABEL,
                zorder=5,
                clip_on=True,
            )
