"""Plot of a protocol: maps of its field at some ticks, and its residuals against time below."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from deploy.plots.theme import DPI, draw_heading, write_picture
from deploy.protocol_report.residuals import CHANGE, DISAGREEMENT, ERROR
from deploy.util.formatting import plural

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.cm import ScalarMappable
    from matplotlib.figure import Figure

    from deploy.protocol_report.report import ProtocolReport
    from deploy.protocol_report.reporter import Reporter

_MAPS: Final = 6
_WIDTH, _LEFT, _RIGHT, _HEAD, _FOOT = 12.4, 0.75, 1.0, 0.95, 0.55
_GAP, _TITLE, _BETWEEN, _CURVES = 0.14, 0.24, 0.45, 3.1
_TALLEST: Final = 6.6
"""Of all maps together, inches."""
_ARROWS: Final = 20
"""Across a map, at most."""
_POINTS: Final = 4000
_SHADES: Final = {CHANGE: "#8fa0b2", ERROR: "#b3541e", DISAGREEMENT: "#2f6f9f"}
_THEORY, _INK, _LABEL = "#22272e", "#22272e", "#5b6570"
_COLOURS, _BEYOND = "viridis", "#d7dce2"
_FAR: Final = 3.0
"""Times the greatest of the other numbers."""
Floats = NDArray[np.float64]


def draw_protocol(reporter: Reporter, report: ProtocolReport, path: Path) -> None:
    """Draw a protocol's run.

    Args:
        reporter: Watched it.
        report: What it came to.
        path: The file to write, a PNG, SVG or PDF by its suffix.

    Raises:
        DeployError: It can't be written.
    """
    write_picture(lambda: _figure(reporter, report), path)


def _figure(reporter: Reporter, report: ProtocolReport) -> Figure:
    from matplotlib.figure import Figure

    chosen = reporter.snapshots.chosen(_MAPS)
    rows, columns = reporter.lattice.rows, reporter.lattice.columns
    tall, wide = int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1
    inside = _WIDTH - _LEFT - _RIGHT
    across, width, height = _layout(len(chosen), wide / tall, inside)
    down = -(-len(chosen) // across)
    maps = down * (height + _TITLE + _GAP)
    page = _HEAD + maps + _BETWEEN + _CURVES + _FOOT
    figure = Figure(figsize=(_WIDTH, page), dpi=DPI, facecolor="white")
    low, high = _range([field for _, field in chosen])
    drawn: ScalarMappable | None = None
    for number, (tick, field) in enumerate(chosen):
        x = _LEFT + (number % across) * (width + _GAP)
        y = page - _HEAD - (number // across) * (height + _TITLE + _GAP) - _TITLE - height
        axes = figure.add_axes((x / _WIDTH, y / page, width / _WIDTH, height / page))
        drawn = _draw_map(axes, _grid(rows, columns, field), low, high)
        axes.set_title(f"tick {tick:,}", size=8.5, color=_LABEL, loc="left", pad=3)
    if drawn is not None:
        size = down * (height + _TITLE + _GAP) - _TITLE - _GAP
        bar = figure.add_axes(
            (
                (_LEFT + across * (width + _GAP)) / _WIDTH,
                (page - _HEAD - _TITLE - size) / page,
                0.14 / _WIDTH,
                size / page,
            )
        )
        figure.colorbar(drawn, cax=bar)
        bar.tick_params(labelsize=7.5)
    curves = figure.add_axes((_LEFT / _WIDTH, _FOOT / page, inside / _WIDTH, _CURVES / page))
    _draw_curves(curves, reporter, report)
    draw_heading(figure, reporter.scene.title or reporter.scene.name, _facts(reporter, report), 0.35)
    return figure


def _layout(maps: int, ratio: float, inside: float) -> tuple[int, float, float]:
    """How many maps in a row, and their size: as large as fits."""
    best = (1, 0.0, 0.0)
    for across in range(1, max(maps, 1) + 1):
        down = -(-maps // across) or 1
        width = (inside - (across - 1) * _GAP) / across
        height = min(width / ratio, _TALLEST / down - _TITLE - _GAP)
        if height > best[2]:
            best = (across, height * ratio, height)
    return best


def _facts(reporter: Reporter, report: ProtocolReport) -> str:
    facts = [
        reporter.scene.cells.firmware.rpartition("/")[2],
        reporter.scene.name,
        plural(report.cells, "cell"),
    ]
    if report.cells_dead:
        facts.append(f"{report.cells_dead:,} died")
    facts.append(f"field: {report.observed}")
    facts.append(
        f"{report.ticks:,} ticks" if report.every_ticks == 1 else f"every {report.every_ticks} ticks"
    )
    return "  ·  ".join(facts)


def _size(field: Floats) -> Floats:
    """Return the values that a map's colours show: numbers, or lengths of vectors."""
    with np.errstate(over="ignore"):
        return field[..., 0] if field.shape[-1] == 1 else np.sqrt((field * field).sum(axis=-1))


def _range(fields: list[Floats]) -> tuple[float, float]:
    """The least and the greatest finite number that the colours distinguish, never the same.

    Of whole numbers one that is far above all others stands for "none" (a distance where no way leads): it is beyond
    the colours.
    """
    sizes = [_size(field) for field in fields]
    finite = np.concatenate([size[np.isfinite(size)] for size in sizes]) if sizes else np.zeros(0)
    if not len(finite):
        return 0.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    others = finite[finite < high]
    if len(others) and high > _FAR * max(float(others.max()), 1.0) and np.all(finite == np.rint(finite)):
        high = float(others.max())
    low = min(low, 0.0) if fields[0].shape[-1] > 1 else low
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _grid(rows: NDArray[np.int64], columns: NDArray[np.int64], field: Floats) -> Floats:
    """``(rows, columns, d)``: NaN where there is no cell, or a dead one."""
    grid = np.full((int(np.ptp(rows)) + 1, int(np.ptp(columns)) + 1, field.shape[1]), np.nan)
    grid[rows - rows.min(), columns - columns.min()] = field
    return grid


def _draw_map(axes: Axes, grid: Floats, low: float, high: float) -> ScalarMappable:
    """A cell a pixel, row 0 at the bottom; arrows where a cell has two numbers."""
    axes.set_facecolor("#eef1f4")
    image = axes.imshow(
        _size(grid),
        origin="lower",
        cmap=_COLOURS,
        vmin=low,
        vmax=high,
        aspect="auto",
        interpolation="nearest",
    )
    image.set_cmap(image.get_cmap().with_extremes(over=_BEYOND))
    axes.set_xticks([])
    axes.set_yticks([])
    for spine in axes.spines.values():
        spine.set_visible(False)
    if grid.shape[2] == 2:
        _draw_arrows(axes, grid, high)
    return image


def _draw_arrows(axes: Axes, grid: Floats, high: float) -> None:
    """A vector's direction and size, of every k-th cell each way where there are many."""
    stride = -(-max(grid.shape[:2]) // _ARROWS)
    start = stride // 2
    part = grid[start::stride, start::stride]
    y, x = start + stride * np.indices(part.shape[:2])
    size = _size(part)
    shown = np.isfinite(size) & (size > 0.02 * high)
    if not shown.any() or not np.isfinite(high):
        return
    shade = np.where(size[shown] > 0.6 * high, 0.1, 1.0)
    axes.quiver(
        x[shown], y[shown], part[shown, 0], part[shown, 1],
        color=[str(one) for one in shade], pivot="mid", angles="xy", scale_units="xy", scale=high / (0.9 * stride),
        width=0.012 / max(1.0, min(grid.shape[1] / stride / 8, 3.0)), headwidth=4, headlength=4, headaxislength=3.6,
    )  # fmt: skip


def _draw_curves(axes: Axes, reporter: Reporter, report: ProtocolReport) -> None:
    """Every residual against the tick, what was fitted and what theory says."""
    residuals = reporter.residuals
    tick = np.array(residuals.tick)
    shown = np.unique(np.linspace(0, max(len(tick) - 1, 0), _POINTS).astype(np.int64))[: len(tick)]
    positive = False
    for name, series in residuals.rms.items():
        rms = np.array(series)[shown]
        there = np.isfinite(rms) & (rms > 0.0)
        positive |= bool(there.any())
        width = 2.4 if name == ERROR else 1.3  # where errors are disagreement, both are seen
        drawn = np.where(there, rms, np.nan)  # a residual of nothing leaves a gap
        axes.plot(tick[shown], drawn, color=_SHADES[name], lw=width, label=f"{name} (rms)", zorder=3)
    if positive:
        axes.set_yscale("log")
        low, high = axes.get_ylim()
        _draw_slopes(axes, reporter, report)
        axes.set_ylim(max(low, 1e-18 * high), high)
    for dead in sorted(set(reporter.deaths.values())):
        axes.axvline(dead, color="#c1121f", lw=0.9, ls=(0, (4, 3)), alpha=0.8, zorder=1)
    axes.set_xlim(0, max(int(tick[-1]) if len(tick) else 1, 1))
    axes.grid(visible=True, color="#e3e7ec", lw=0.7)
    axes.set_axisbelow(True)
    axes.set_xlabel("tick")
    axes.set_ylabel(f"residual of {report.observed}")
    if axes.get_legend_handles_labels()[0]:
        axes.legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 1.0),
            ncols=5,
            frameon=False,
            fontsize=8.5,
            borderaxespad=0.1,
        )


def _draw_slopes(axes: Axes, reporter: Reporter, report: ProtocolReport) -> None:
    """The ticks that were fitted, and there theory's slope, beside the residual's."""
    rate, name = report.rate, report.rate_of
    bound = report.predicted_ticks
    if bound is not None:
        label = f"theory: done after {bound:,} ticks"
        axes.axvline(bound, color=_THEORY, lw=1.2, ls=(0, (5, 3)), zorder=2, label=label)
    if rate is None or name is None:
        return
    axes.axvspan(rate.from_tick, rate.to_tick, color=_SHADES[name], alpha=0.08, lw=0, zorder=0)
    if report.predicted_factor is None or report.predicted_factor <= 0.0:
        return
    tick = np.array(reporter.residuals.tick)
    rms = np.array(reporter.residuals.rms[name])
    fit = (tick >= rate.from_tick) & (tick <= rate.to_tick) & (rms > 0.0)
    middle = float(np.mean(tick[fit]))
    height = float(np.mean(np.log10(rms[fit])))
    span = np.array([rate.from_tick, rate.to_tick], dtype=np.float64)
    line = 10.0 ** (height + (span - middle) * np.log10(report.predicted_factor))
    axes.plot(
        span, line, color=_THEORY, lw=1.3, ls=(0, (5, 3)), zorder=4,
        label=f"theory: {report.predicted_factor:.6g} a tick; measured {rate.factor:.6g}",
    )  # fmt: skip
