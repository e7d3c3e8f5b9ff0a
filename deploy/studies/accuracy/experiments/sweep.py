"""Cost of accuracy on a scene: the study of ``mdms accuracy``, reduced to a section of the page."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from deploy.studies.accuracy.console import adapter_words, heading, metres, verdict
from deploy.studies.accuracy.experiments.markdown import (
    Section,
    error,
    milliseconds,
    picture,
    power,
    prose,
    table,
)
from deploy.studies.accuracy.experiments.runs import scene_with
from deploy.studies.accuracy.plots import draw_sampling, draw_tolerance, draw_work_precision
from deploy.studies.accuracy.report import AccuracyReport, AccuracyRow
from deploy.studies.accuracy.study import StudyPlan, study

TARGETS_M = (1e-3, 1e-5, 1e-7, 1e-9, 1e-11)
TIMING_S = 1.5
"""A setting is not repeated once its runs have taken this long."""


def section(scene: str, repeats: int, *, sampling: bool) -> Section:
    """The section of the page on one bundled scene; ``sampling``: with the whole system, too."""
    return describe(
        study(scene_with(scene), StudyPlan(repeats=repeats, timing_s=TIMING_S, sampling=sampling)), repeats
    )


def describe(report: AccuracyReport, repeats: int) -> Section:
    """Describe the study's results in Markdown."""
    drawn: dict[str, tuple[Callable[[AccuracyReport, Path], None], str]] = {
        f"{report.scene}_cost.png": (
            draw_work_precision,
            "error against processor time in calls of the solver, a line a solver, both logarithmic",
        ),
        f"{report.scene}_tolerance.png": (
            draw_tolerance,
            "error got against tolerance asked, both logarithmic",
        ),
    }
    if report.sampling:
        drawn[f"{report.scene}_sampling.png"] = (
            draw_sampling,
            "error of the whole system against its wall time as the control period shrinks",
        )
    first, *rest = heading(report)[1:]
    text = prose(
        "sweep",
        scene=report.scene,
        duration=f"{report.duration_s:g}",
        cells=f"{report.cells:,}",
        reference="\n".join([f"{first[0].upper()}{first[1:]}:", "", *(f"- {line.strip()}" for line in rest)]),
        verdict=_verdict(report),
        pictures="\n\n".join(picture(file, says) for file, (_, says) in drawn.items()),
        table=_reached(report),
        worst=_worst(report),
        remarks="\n".join(f"- {line}" for line in _remarks(report)),
        repeats=str(repeats),
    )
    pictures = {file: partial(draw, report) for file, (draw, _) in drawn.items()}
    return Section(f"What accuracy costs: `{report.scene}`", text, pictures)


def _verdict(report: AccuracyReport) -> str:
    head, *lines = verdict(report)
    return "\n".join([f"{head[0].upper()}{head[1:]}", "", *(f"- {line.strip()}" for line in lines)])


def _reached(report: AccuracyReport) -> str:
    """A line a solver, a column a target."""
    lines: list[list[str]] = []
    for line in report.lines:
        rows = [row for row in report.rows if row.line == line and row.error_max is not None]
        if rows:
            lines.append([line, *(_coarsest(rows, target) for target in TARGETS_M)])
    return table(["solver", *(f"{power(target)} m" for target in TARGETS_M)], lines)


def _coarsest(rows: list[AccuracyRow], target_m: float) -> str:
    """The first, which is the coarsest, that reaches a target."""
    for row in rows:
        if row.error_max is not None and row.error_max <= target_m:
            return f"{power(row.value or 0.0)}: {milliseconds(row.wall_s or 0.0)}"
    return "–"


def _worst(report: AccuracyReport) -> str:
    """How much more than requested the error of a solver is at most that has a tolerance."""
    found: list[str] = []
    for line in report.lines:
        ratios = [
            row.error_max / row.value
            for row in report.rows
            if row.line == line and row.key == "tolerance" and row.error_max is not None and row.value
        ]
        if ratios:
            found.append(f"{line} {error(max(ratios))}")
    return f"Error over tolerance, at most: {', '.join(found)}." if found else ""


def _remarks(report: AccuracyReport) -> list[str]:
    """List remarks on the table, without repetition: omitted physics, failed rows, and divergent orders of events."""
    rows = report.rows
    found = [f"{row.line} {row.note}." for row in rows if row.note and row.status == "ok"]
    found += [
        f"{row.solver} is judged by {row.judged_by}, not by itself."
        for row in rows
        if row.judged_by and row.judged_by != report.reference.solver
    ]
    found += [f"{name}: {adapter_words(library)}." for name, library in report.adapters.items()]
    found += [f"{_named(row)}: {row.status}: {row.reason}." for row in rows if row.status != "ok"]
    parted = [
        f"{_named(row)} from {row.order_until:.4g} s ({metres(row.error_before)} m before)"
        for row in rows
        if row.order_until is not None and row.note is None
    ]
    if parted:
        found.append(f"The order of events is not the reference's with {', '.join(parted)}.")
    return list(dict.fromkeys(found))


def _named(row: AccuracyRow) -> str:
    """A setting; what no setting of a solver is tried for, that solver."""
    return row.solver if row.value is None or row.status == "omitted" else f"{row.line} {power(row.value)}"
