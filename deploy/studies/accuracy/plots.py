"""The pictures of a study: work against precision, requested tolerance against error, the cost of sampling."""

# pyright: reportUnknownMemberType=false

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deploy.plots.theme import DPI, draw_heading, write_picture
from deploy.util.colours import COLOURS
from deploy.util.files import write_text
from deploy.util.formatting import plural

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from deploy.studies.accuracy.report import AccuracyReport, AccuracyRow


_WIDTH, _HEIGHT = 10.6, 6.0
"""Of a page, inches."""
_MARKS = "os^Dv<>Ph*X"
_STROKES = ("-", "--", "-.", ":")
_SHADES = {
    "exact": ("#0072b2",),
    "implicit": ("#d55e00", "#e8a06a"),
    "quasi_static": ("#009e73",),
    "fixed_step": ("#cc79a7", "#93407a"),
    "scipy": ("#8c6d00", "#e0b100", "#22272e", "#7d8894"),
    "heyoka": ("#332288",),
}
"""Colours of each solver's lines."""
_FLOOR_M = 1e-16
"""Errors below this, nought among them, are drawn here: rounding."""
_GUIDE = "#8b95a1"


def draw_work_precision(report: AccuracyReport, path: Path) -> None:
    """Error against wall time, a line a solver, both logarithmic."""
    write_picture(lambda: _work_precision(report), path)


def draw_tolerance(report: AccuracyReport, path: Path) -> None:
    """Error against requested tolerance, both logarithmic, with the line of slope 1."""
    write_picture(lambda: _tolerance(report), path)


def draw_sampling(report: AccuracyReport, path: Path) -> None:
    """Error of the whole system against its wall time, a point a control period."""
    write_picture(lambda: _sampling(report), path)


def _page(report: AccuracyReport, title: str, facts: Sequence[str]) -> tuple[Figure, Axes]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(_WIDTH, _HEIGHT), dpi=DPI, facecolor="white")
    axes = figure.add_axes((0.075, 0.1, 0.62, 0.74))
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.grid(visible=True, which="major", color="#e4e8ec", lw=0.8)
    axes.set_axisbelow(True)
    axes.minorticks_off()
    draw_heading(figure, title, "  ·  ".join([report.scene, report.title, *facts]), 0.35)
    return figure, axes


def _of(report: AccuracyReport, line: str) -> list[AccuracyRow]:
    return [row for row in report.rows if row.line == line and row.error_max is not None]


def _errors(rows: Sequence[AccuracyRow]) -> list[float]:
    return [max(row.error_max or 0.0, _FLOOR_M) for row in rows]


def line_style(report: AccuracyReport, line: str) -> dict[str, Any]:
    """Colour, stroke and mark of a line, the same in every picture."""
    solver = next(row.solver for row in report.rows if row.line == line)
    among = list(dict.fromkeys(row.line for row in report.rows if row.solver == solver)).index(line)
    shades = _SHADES.get(solver, COLOURS)
    return {
        "color": shades[among % len(shades)],
        "marker": _MARKS[report.lines.index(line) % len(_MARKS)],
        "ls": _STROKES[among % len(_STROKES)],
        "ms": 5.5,
        "lw": 2.2 if solver == "exact" else 1.3,
        "zorder": 5 if solver == "exact" else 3,
    }


def _legend(axes: Axes, report: AccuracyReport) -> None:
    """List the curves, those of the plant's kernels first, then those of libraries by their adapters."""
    from matplotlib.lines import Line2D

    drawn = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    adapters = {
        line: library
        for line in report.lines
        for solver, library in report.adapters.items()
        if any(row.line == line and row.solver == solver for row in report.rows)
    }
    groups: dict[str, list[str]] = {}
    for label in drawn:
        library = adapters.get(label)
        groups.setdefault(f"adapter to\n{library}" if library else "kernels of the plant", []).append(label)
    handles: list[Any] = []
    for head, labels in groups.items():
        handles += [Line2D([], [], ls="", label=head), *(drawn[label] for label in labels)]
    legend = axes.legend(
        handles=handles, loc="upper left", bbox_to_anchor=(1.01, 1.02), frameon=False, borderaxespad=0.0
    )
    for text in legend.get_texts():
        if text.get_text() in groups:
            text.set_color(_GUIDE)
            text.set_position((-28.0, 0.0))
    _list(axes, [f"{row.line}: {row.status}" for row in report.rows if row.error_max is None])


def _work_precision(report: AccuracyReport) -> Figure:
    figure, axes = _page(
        report, "Work and precision", [f"{report.duration_s:g} s", f"reference: {report.reference.method}"]
    )
    for line in report.lines:
        rows = _of(report, line)
        if not rows:
            continue
        shortest = [1e3 * (row.solver_low_s or 0.0) for row in rows]
        more = [1e3 * (row.solver_s or 0.0) - low for row, low in zip(rows, shortest, strict=True)]
        axes.errorbar(
            shortest,
            _errors(rows),
            xerr=[[0.0] * len(rows), more],
            label=line,
            elinewidth=0.7,
            **line_style(report, line),
        )
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_xlabel("processor time of a run in calls of the solver (ms): shortest; bars: to the median")
    axes.set_ylabel("largest displacement of a corner over the run (m)")
    _legend(axes, report)
    return figure


def _tolerance(report: AccuracyReport) -> Figure:
    figure, axes = _page(
        report,
        "Tolerance asked, error got",
        [f"{report.duration_s:g} s", "on the dashed line a solver gives what was asked"],
    )
    all_tolerances: list[float] = []
    for line in report.lines:
        rows = [row for row in _of(report, line) if row.key == "tolerance"]
        if not rows:
            continue
        tolerances = [row.value or 0.0 for row in rows]
        all_tolerances += tolerances
        axes.plot(tolerances, _errors(rows), label=line, **line_style(report, line))
    if all_tolerances:
        ends = [min(all_tolerances), max(all_tolerances)]
        axes.plot(ends, ends, ls="--", color=_GUIDE, lw=1.2, zorder=2)
    axes.invert_xaxis()
    axes.set_xlabel("tolerance asked (m; with scipy and heyoka of a step)")
    axes.set_ylabel("error got: largest displacement of a corner (m)")
    _legend(axes, report)
    return figure


def _sampling(report: AccuracyReport) -> Figure:
    figure, axes = _page(
        report,
        "The price of sampling",
        [plural(report.cells, "cell"), "cells, bus and plant in one process"],
    )
    lowest, highest = 1.0, _FLOOR_M
    for number, sampling in enumerate(report.sampling):
        rows = [row for row in sampling.rows if row.error_max is not None]
        walls, errors = (
            [row.wall_s or 0.0 for row in rows],
            [max(row.error_max or 0.0, _FLOOR_M) for row in rows],
        )
        label = f"{sampling.wheels}:\nerrors from\n{sampling.against}"
        axes.plot(walls, errors, marker=_MARKS[number], color=COLOURS[number], lw=1.6, ms=6, label=label)
        lowest, highest = min([lowest, *errors]), max([highest, *errors])
        for row, wall, error in zip(rows, walls, errors, strict=True):
            axes.annotate(
                f"{row.period_s * 1e3:.3g} ms",
                (wall, error),
                xytext=(0, 8),
                textcoords="offset points",
                ha="center",
                fontsize=8,
            )
    axes.set_ylim(lowest / 10.0, highest * 10.0)
    axes.set_xlabel("wall time of the run (s); beside each point the control period")
    axes.set_ylabel("largest displacement of a corner (m)")
    axes.legend(
        loc="upper left", bbox_to_anchor=(1.01, 1.0), frameon=False, borderaxespad=0.0, labelspacing=1.2
    )
    _list(
        axes,
        [
            f"{row.period_s * 1e3:.3g} ms: {row.status}"
            for one in report.sampling
            for row in one.rows
            if row.status != "ok"
        ],
    )
    return figure


def _list(axes: Axes, left: Sequence[str]) -> None:
    """List the names of omitted curves beside the plot."""
    if left:
        text = "\n".join(["not drawn", *dict.fromkeys(left)])
        axes.text(1.03, 0.0, text, transform=axes.transAxes, fontsize=7.5, color="#6b7580", va="bottom")


JSON_NAME = "accuracy.json"
CSV_NAME = "accuracy.csv"
WORK_PRECISION = "work_precision.png"
TOLERANCE = "tolerance.png"
SAMPLING = "sampling.png"


def write_report(report: AccuracyReport, folder: Path) -> None:
    """Write all files, each whole or not at all.

    Raises:
        DeployError: One can't be written.
    """
    write_text(folder / JSON_NAME, report.to_json() + "\n")
    write_text(folder / CSV_NAME, report.to_csv())
    draw_work_precision(report, folder / WORK_PRECISION)
    draw_tolerance(report, folder / TOLERANCE)
    if report.sampling:
        draw_sampling(report, folder / SAMPLING)
