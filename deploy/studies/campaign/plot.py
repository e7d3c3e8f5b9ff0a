"""Plot of a campaign: success, error and time over one varied value, or maps over two."""

# pyright: reportUnknownMemberType=false
# (matplotlib leaves the keywords of its drawing methods untyped.)

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from deploy.plots.map_view import INK
from deploy.plots.theme import DPI, draw_heading, write_picture
from deploy.studies.campaign.console import value_of
from deploy.util.formatting import plural

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from deploy.studies.campaign.cases import Axis
    from deploy.studies.campaign.report import CampaignReport, CampaignRow, Mean
    from plant.wheels import Floats

FILE_NAME = "campaign.png"
_PANEL, _GAP, _LEFT, _RIGHT, _FOOT, _HEAD = 3.35, 0.85, 0.75, 0.35, 0.6, 1.1
"""Sides of a panel, and what is around panels, inches."""
_LEAST = 9.4
"""Width that a title needs, inches."""
_BAR = 0.75
"""Width of a map's colour bar with its numbers, inches."""
_WORDS = 0.6
"""Room beside a map for values that are words, inches."""
_LABELS = 12
"""Values along an axis that are labelled; of more, every second or third is."""
_NONE = "#e3e7ec"
"""Where there is nothing to show."""


@final
@dataclass(frozen=True, slots=True)
class _Measure:
    """One measure over all rows: ``(n,)`` each, NaN where there is none.

    Attributes:
        partly: Where it is of some of the runs only.
        colours: Of a map.
        limits: Least and greatest value of a scale, where they are given.
    """

    name: str
    middle: Floats
    low: Floats
    high: Floats
    partly: NDArray[np.bool_]
    colours: str
    limits: tuple[float | None, float | None]


def why_none(report: CampaignReport) -> str:
    """Return why no plot is drawn; empty if a plot is drawn."""
    varied = len(_varied(report))
    if varied == 0:
        return "no value is varied"
    return (
        ""
        if varied <= 2
        else f"{varied} values are varied; a plot shows one or two (the table and the CSV file have all)"
    )


def draw_campaign(report: CampaignReport, path: Path) -> None:
    """Draw a campaign over the one or two values that are varied as a PNG.

    Args:
        report: What it came to; see `why_none`.
        path: The file to write.

    Raises:
        DeployError: It can't be written.
    """
    write_picture(lambda: _figure(report), path)


def _varied(report: CampaignReport) -> list[Axis]:
    return [axis for axis in report.cases.axes if len(axis.values) > 1]


def _figure(report: CampaignReport) -> Figure:
    from matplotlib.figure import Figure

    axes = _varied(report)
    measures = _measures(report.rows)
    maps = len(axes) == 2
    words = _WORDS if maps and any(isinstance(value, str) for value in axes[1].values) else 0.0
    beside, before = _BAR if maps else 0.0, _LEFT + words
    around = before + len(measures) * beside + (len(measures) - 1) * (_GAP + words) + _RIGHT
    width, height = max(around + len(measures) * _PANEL, _LEAST), _FOOT + _PANEL + _HEAD
    across = (width - around) / len(measures)
    figure = Figure(figsize=(width, height), dpi=DPI, facecolor="white")
    for number, measure in enumerate(measures):
        left = before + number * (across + beside + _GAP + words)
        panel = figure.add_axes((left / width, _FOOT / height, across / width, _PANEL / height))
        panel.set_title(measure.name, loc="left", color=INK, fontsize=10)
        if maps:
            place = ((left + across + 0.12) / width, _FOOT / height, 0.15 / width, _PANEL / height)
            _draw_map(panel, figure.add_axes(place), axes, measure)
        else:
            _draw_curve(panel, axes[0], measure)
    draw_heading(figure, report.cases.scene.title or report.spec.scene, _facts(report, measures), 0.35)
    return figure


def _facts(report: CampaignReport, measures: Sequence[_Measure]) -> str:
    spec = report.spec
    facts = [spec.scene, plural(len(report.cases.seeds), "seed"), plural(len(report.outcomes), "run")]
    if spec.fault:
        facts.insert(1, f"fault {spec.fault}")
    failed = sum(row.failed for row in report.rows)
    if failed:
        facts.append(f"{failed:,} failed")
    if len(_varied(report)) == 1:
        if len(report.cases.seeds) > 1:
            facts.append(f"bands: {100 * spec.confidence:g} % confidence")
        if any(np.any(one.partly & np.isfinite(one.middle)) for one in measures):
            facts.append("rings: of some of the runs")
    return "  ·  ".join(facts)


def _measures(rows: Sequence[CampaignRow]) -> list[_Measure]:
    """Success, and those of error and time that any run has."""
    shares = [(row.success.share, row.success.low, row.success.high) for row in rows]
    found = [
        _measure("success (%)", shares, [False] * len(rows), "viridis", (0.0, 100.0), 100.0),
        _mean("error (m)", [row.error_m for row in rows], rows, (0.0, None)),
        _mean("time to rest or leave (s)", [row.time_s for row in rows], rows, (None, None)),
    ]
    return [measure for measure in found if np.any(np.isfinite(measure.middle))]


def _mean(
    name: str, means: Sequence[Mean], rows: Sequence[CampaignRow], limits: tuple[float | None, float | None]
) -> _Measure:
    partly = [one.runs < row.runs for one, row in zip(means, rows, strict=True)]
    return _measure(name, [(one.mean, one.low, one.high) for one in means], partly, "cividis", limits)


def _measure(
    name: str,
    numbers: Sequence[tuple[float | None, float | None, float | None]],
    partly: Sequence[bool],
    colours: str,
    limits: tuple[float | None, float | None],
    unit: float = 1.0,
) -> _Measure:
    """Of middle, low and high of every row, in parts of ``1 / unit``."""
    parts = unit * np.array([[np.nan if one is None else one for one in row] for row in numbers])
    return _Measure(name, parts[:, 0], parts[:, 1], parts[:, 2], np.array(partly), colours, limits)


def _draw_curve(panel: Axes, axis: Axis, measure: _Measure) -> None:
    """A line with its band over numbers; bars of the intervals over anything else."""
    shade = "#0072b2"
    if all(isinstance(value, int | float) and not isinstance(value, bool) for value in axis.values):
        x = np.array(axis.values, dtype=np.float64)
        order = np.argsort(x)
        panel.fill_between(x[order], measure.low[order], measure.high[order], color=shade, alpha=0.18, lw=0)
        panel.plot(x[order], measure.middle[order], color=shade, lw=1.4)
        margin = 0.05 * float(np.ptp(x))
    else:
        x = np.arange(len(axis.values), dtype=np.float64)
        panel.vlines(x, measure.low, measure.high, color=shade, alpha=0.35, lw=4)
        margin = 0.5
        _name_ticks(panel.xaxis, axis.values)
    for chosen, fill in ((~measure.partly, shade), (measure.partly, "white")):
        panel.plot(x[chosen], measure.middle[chosen], "o", color=shade, mfc=fill, ms=4.5, zorder=3)
    panel.set_xlim(x.min() - margin, x.max() + margin)
    low, high = measure.limits
    if high is not None:
        panel.set_ylim(-3.0, 103.0)
    elif low is not None:
        panel.set_ylim(bottom=low)
    panel.set_xlabel(axis.key, parse_math=False)
    panel.grid(color="#e3e7ec", lw=0.6)
    panel.set_axisbelow(True)


def _draw_map(panel: Axes, bar: Axes, axes: Sequence[Axis], measure: _Measure) -> None:
    """A square a case, the first value to the right and the second upwards."""
    first, second = (axis.values for axis in axes)
    table = measure.middle.reshape(len(first), len(second)).T
    mesh = panel.pcolormesh(
        np.arange(len(first) + 1) - 0.5,
        np.arange(len(second) + 1) - 0.5,
        np.ma.masked_invalid(table),
        cmap=measure.colours,
        vmin=measure.limits[0],
        vmax=measure.limits[1],
    )
    panel.set_facecolor(_NONE)
    panel.figure.colorbar(mesh, cax=bar)
    _name_ticks(panel.xaxis, first)
    _name_ticks(panel.yaxis, second)
    panel.set_xlabel(axes[0].key, parse_math=False)
    panel.set_ylabel(axes[1].key, parse_math=False)


def _name_ticks(ticks: Any, values: Sequence[Any]) -> None:
    """Name places along an axis by their values."""
    every = -(-len(values) // _LABELS)
    ticks.set_ticks(
        range(0, len(values), every),
        labels=[value_of(value)[:14] for value in values[::every]],
        parse_math=False,
    )
