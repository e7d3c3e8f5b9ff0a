"""Plot of a parcel's rest orientations: torque against angle, and the parcel at every stable angle."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deploy.plots.map_view import INK, LABEL, draw_map
from deploy.plots.theme import DPI, draw_heading, write_picture
from deploy.recordings.trace import RunTrace
from deploy.util.colours import colour
from deploy.util.formatting import format_point, plural
from plant.analysis.static_supports import footprint

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from deploy.studies.orientations.study import OrientationStudy, SizeMap
    from plant.analysis.orientations import Orientation, TorqueProfile
    from plant.wheels import Floats


FILE_NAME = "orientations.png"
_WIDTH, _HEIGHT, _VIEW = 12.4, 5.45, 3.9
"""Of the page and of the square view at its left, inches."""
_STEPS, _SMOOTH, _NEUTRAL = "#22272e", "#8fa0b2", "#c9d0d8"
_LABELS = 12
"""Stable orientations beyond this many are marked without their angle: words would lie on words."""


def draw_orientations(study: OrientationStudy, profile: TorqueProfile, path: Path) -> None:
    """Draw torque against angle as a PNG.

    Args:
        study: Whose profile it is.
        profile: The torque.
        path: The file to write.

    Raises:
        DeployError: It can't be written.
    """
    write_picture(lambda: _draw_figure(study, profile), path)


def _draw_figure(study: OrientationStudy, profile: TorqueProfile) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, _HEIGHT), dpi=DPI, facecolor="white")
    below = 0.55 / _HEIGHT
    view = figure.add_axes((0.75 / _WIDTH, below, _VIEW / _WIDTH, _VIEW / _HEIGHT))
    steps = figure.add_axes((5.75 / _WIDTH, below, 6.3 / _WIDTH, _VIEW / _HEIGHT))
    _draw_view(view, study, profile.stable())
    _draw_torque(steps, study, profile)
    scene = study.scene
    facts = [
        scene.name,
        plural(len(study.array), "cell"),
        f"parcel {study.parcel} turned about {format_point(profile.centre_m)} m",
        f"supports change at {plural(len(profile.angles_rad), 'angle')}",
        plural(len(profile.stable()), "stable orientation"),
    ]
    if np.any(np.isnan(profile.torque_n_m)):
        facts.append("hatched: it tips")
    draw_heading(figure, scene.title or scene.name, "  ·  ".join(facts), 0.35)
    return figure


def _draw_view(axes: Axes, study: OrientationStudy, stable: tuple[Orientation, ...]) -> None:
    """The cells about the parcel and, in a colour each, the parcel at its stable orientations."""
    corners = footprint(study.scene.parcels[study.parcel])
    draw_map(
        axes,
        RunTrace(
            title="",
            scene=study.scene.name,
            pitch_m=study.array.pitch_m,
            cells=study.array.lattice.cells,
            positions_m=study.array.positions_m,
            footprints_m=(),
            time_s=np.zeros(0),
            parcels=np.zeros((0, 0, 6)),
            wheel_speeds=study.speeds_m_s,
        ),
    )
    if not stable:
        _outline(axes, corners, study.centre_m, study.scene.parcels[study.parcel].angle_rad, INK)
    for number, one in enumerate(stable):
        _outline(axes, corners, study.centre_m, _middle(one), colour(number))
    reach = 1.15 * float(np.max(np.hypot(corners[:, 0], corners[:, 1]))) + study.array.pitch_m
    axes.set_xlim(study.centre_m[0] - reach, study.centre_m[0] + reach)
    axes.set_ylim(study.centre_m[1] - reach, study.centre_m[1] + reach)


def _outline(axes: Axes, corners: Floats, centre: Floats, angle: float, shade: str) -> None:
    """A parcel at an angle, with its x axis as a pointer."""
    c, s = np.cos(angle), np.sin(angle)
    turn = np.array([[c, s], [-s, c]])
    axes.fill(*(corners @ turn + centre).T, fill=False, ec=shade, lw=1.8, joinstyle="round", zorder=5)
    front = np.array([[0.0, 0.0], [1.12 * float(corners[:, 0].max()), 0.0]]) @ turn + centre
    axes.plot(*front.T, color=shade, lw=1.4, zorder=6)
    axes.plot(*front[1], "o", ms=5, color=shade, zorder=6)


def _draw_torque(axes: Axes, study: OrientationStudy, profile: TorqueProfile) -> None:
    edges = np.concatenate([[0.0], np.degrees(profile.angles_rad), [360.0]])
    values = np.append(profile.torque_n_m[-1], profile.torque_n_m[: len(profile.angles_rad)])
    axes.axhline(0.0, color="#8b95a1", lw=0.8, zorder=1)
    axes.stairs(values, edges, baseline=None, color=_STEPS, lw=1.2, zorder=3, label="this array")
    fine = np.linspace(0.0, 360.0, 721)
    smooth = study.continuous(np.radians(fine))
    if smooth is not None:
        axes.plot(fine, smooth, color=_SMOOTH, lw=1.5, zorder=2, label="a continuous surface")
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, frameon=False, borderaxespad=0.2)
    _shade_falls(axes, values, edges)
    axes.set_xlim(0.0, 360.0)
    axes.set_xticks(np.arange(0, 361, 45))
    axes.margins(y=0.12)
    axes.set_xlabel("angle (degrees)")
    axes.set_ylabel("torque (N m)")
    number = 0
    for one in profile.orientations():
        _mark(axes, one, number if one.stable else None, labelled=len(profile.stable()) <= _LABELS)
        number += one.stable


def _shade_falls(axes: Axes, values: Floats, edges: Floats) -> None:
    """Hatch where the parcel doesn't stand."""
    for step in np.flatnonzero(np.isnan(values)):
        axes.axvspan(edges[step], edges[step + 1], facecolor="none", edgecolor=_NEUTRAL, hatch="////", lw=0)


def _mark(axes: Axes, one: Orientation, number: int | None, *, labelled: bool) -> None:
    """A span for an interval; a dot where the parcel is stable, a ring where it is not."""
    low, high = np.degrees((one.low_rad, one.high_rad))
    shade = _NEUTRAL if number is None else colour(number)
    if one.is_interval:
        for turn in (0.0, 360.0) if high > 360.0 else (0.0,):
            axes.axvspan(low - turn, high - turn, color=shade, alpha=0.35, lw=0, zorder=0.5)
    place = float(np.degrees(_middle(one))) % 360.0
    if number is None:
        if one.nature == "repelling":
            axes.plot(place, 0.0, "o", ms=4.5, mfc="white", mec=INK, mew=0.9, zorder=5)
        return
    axes.plot(place, 0.0, "o", ms=6, color=shade, zorder=6, clip_on=False)
    if labelled:
        axes.annotate(
            f"{place:.5g}°",
            (place, 0.0),
            xytext=(0, 9 if number % 2 == 0 else -16),
            textcoords="offset points",
            ha="center",
            color=shade,
            fontsize=8,
            fontweight="bold",
            bbox=LABEL,
            zorder=7,
        )


def _middle(one: Orientation) -> float:
    return 0.5 * (one.low_rad + one.high_rad)


SIZES_FILE_NAME = "orientation_sizes.png"
_SIZES_WIDTH, _SIZES_HEIGHT, _PANEL = 11.3, 5.65, 3.9
"""Of the page and of each square panel, inches."""
_NONE = "#e3e7ec"
"""Where nothing is stable."""


def draw_sizes(study: OrientationStudy, sizes: SizeMap, path: Path) -> None:
    """Draw the map as a PNG.

    Args:
        study: Whose field and point it is.
        sizes: The orientations.
        path: The file to write.

    Raises:
        DeployError: It can't be written.
    """
    write_picture(lambda: _draw_sizes_figure(study, sizes), path)


def _draw_sizes_figure(study: OrientationStudy, sizes: SizeMap) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_SIZES_WIDTH, _SIZES_HEIGHT), dpi=DPI, facecolor="white")
    for left, draw in ((0.8, _draw_counts), (6.2, _draw_nearest)):
        axes, bar = (
            figure.add_axes(
                (x / _SIZES_WIDTH, 0.6 / _SIZES_HEIGHT, across / _SIZES_WIDTH, _PANEL / _SIZES_HEIGHT)
            )
            for x, across in ((left, _PANEL), (left + _PANEL + 0.15, 0.18))
        )
        draw(axes, bar, sizes)
        axes.set_facecolor(_NONE)
        axes.set_xlim(*_borders(sizes.lengths_m)[[0, -1]])
        axes.set_ylim(*_borders(sizes.widths_m)[[0, -1]])
        axes.set_xlabel("length (m)")
        axes.set_ylabel("width (m)")
        _mark_own(axes, study, sizes)
    scene = study.scene
    facts = [
        scene.name,
        plural(len(study.array), "cell"),
        f"{sizes.counts().size:,} sizes turned about {format_point(study.centre_m)} m",
        "grey: nothing stable",
    ]
    draw_heading(figure, scene.title or scene.name, "  ·  ".join(facts), 0.35)
    return figure


def _borders(values: Floats) -> Floats:
    """``(n + 1,)`` borders of strips about ``(n,)`` values."""
    if len(values) == 1:
        return values * np.array([0.95, 1.05])
    half = 0.5 * np.diff(values)
    return np.concatenate([values[:1] - half[:1], values[:-1] + half, values[-1:] + half[-1:]])


def _draw_counts(axes: Axes, bar: Axes, sizes: SizeMap) -> None:
    """Each number of stable orientations in a colour of its own."""
    import matplotlib as mpl
    from matplotlib.colors import BoundaryNorm, ListedColormap

    counts = sizes.counts()
    numbers = np.unique(counts[counts > 0])
    axes.set_title("stable orientations a turn", loc="left", color=INK, fontsize=10)
    if not len(numbers):
        bar.set_axis_off()
        return
    which = np.searchsorted(numbers, counts).astype(np.float64)
    which[counts <= 0] = np.nan
    shades = mpl.colormaps["viridis"](np.linspace(0.1, 0.95, len(numbers)))
    norm = BoundaryNorm(np.arange(len(numbers) + 1) - 0.5, len(numbers))
    mesh = axes.pcolormesh(
        _borders(sizes.lengths_m),
        _borders(sizes.widths_m),
        which,
        cmap=ListedColormap(list(shades)),
        norm=norm,
    )
    axes.figure.colorbar(mesh, cax=bar, ticks=np.arange(len(numbers)))
    bar.set_yticklabels([str(number) for number in numbers])
    bar.minorticks_off()


def _draw_nearest(axes: Axes, bar: Axes, sizes: SizeMap) -> None:
    axes.set_title("stable orientation nearest to 0°, degrees from it", loc="left", color=INK, fontsize=10)
    mesh = axes.pcolormesh(
        _borders(sizes.lengths_m),
        _borders(sizes.widths_m),
        np.degrees(sizes.nearest_rad()),
        cmap="cividis",
        vmin=0.0,
        vmax=90.0,
    )
    axes.figure.colorbar(mesh, cax=bar, ticks=np.arange(0, 91, 15))


def _mark_own(axes: Axes, study: OrientationStudy, sizes: SizeMap) -> None:
    """A ring at the size of the scene's own parcel."""
    size = study.scene.parcels[study.parcel].size_m
    bounds = [(values[0], values[-1]) for values in (sizes.lengths_m, sizes.widths_m)]
    if size and all(min(pair) <= side <= max(pair) for side, pair in zip(size, bounds, strict=True)):
        axes.plot(*size, "o", ms=9, mfc="none", mec="white", mew=3.2)
        axes.plot(*size, "o", ms=9, mfc="none", mec=INK, mew=1.4)
