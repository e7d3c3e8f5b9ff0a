"""The picture of the orientations over sizes: how many are stable, and how far the nearest is from 0."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from deploy.overview.scenery import INK
from deploy.picture import DPI, draw_heading, write_picture
from deploy.words import counted, point

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from deploy.orientations.sizes import SizeMap
    from deploy.orientations.study import Study
    from plant.wheels import Floats

SIZES_FILE_NAME = "orientation_sizes.png"
_SIZES_WIDTH, _SIZES_HEIGHT, _PANEL = 11.3, 5.65, 3.9
"""Of the page and of each square panel, inches."""
_NONE = "#e3e7ec"
"""Where nothing is stable."""


def draw_sizes(study: Study, sizes: SizeMap, path: Path) -> None:
    """Draw the map as a PNG.

    Args:
        study: Whose field and point it is.
        sizes: The orientations.
        path: The file to write.

    Raises:
        DeployError: It can't be written.
    """
    write_picture(lambda: _draw_sizes_figure(study, sizes), path)


def _draw_sizes_figure(study: Study, sizes: SizeMap) -> Figure:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_SIZES_WIDTH, _SIZES_HEIGHT), dpi=DPI, facecolor="white")
    for left, draw in ((0.8, _draw_counts), (6.2, _draw_nearest)):
        axes, bar = (
            figure.add_axes((x / _SIZES_WIDTH, 0.6 / _SIZES_HEIGHT, across / _SIZES_WIDTH, _PANEL / _SIZES_HEIGHT))
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
        counted(len(study.array), "cell"),
        f"{sizes.counts().size:,} sizes turned about {point(study.centre_m)} m",
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


def _mark_own(axes: Axes, study: Study, sizes: SizeMap) -> None:
    """A ring at the size of the scene's own parcel."""
    size = study.scene.parcels[study.parcel].size_m
    bounds = [(values[0], values[-1]) for values in (sizes.lengths_m, sizes.widths_m)]
    if size and all(min(pair) <= side <= max(pair) for side, pair in zip(size, bounds, strict=True)):
        axes.plot(*size, "o", ms=9, mfc="none", mec="white", mew=3.2)
        axes.plot(*size, "o", ms=9, mfc="none", mec=INK, mew=1.4)
