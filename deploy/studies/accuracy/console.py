"""Terminal output of an accuracy study."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from deploy.util.formatting import plural

if TYPE_CHECKING:
    from deploy.studies.accuracy.report import AccuracyReport, AccuracyRow, Sampling

_WIDTH = 148
"""Columns that the table needs."""
_KEY = (
    "error: largest displacement of any corner of a footprint. events: found −missed +invented; times: largest time "
    "error of found events. wall: median. s/s: simulated seconds a second. steps: with scipy right-hand sides."
)


def print_report(report: AccuracyReport) -> None:
    """Print the reference, every row, what was left out and why, and the price of sampling."""
    console = Console(highlight=False)
    if console.width < _WIDTH:
        console = Console(highlight=False, width=_WIDTH)
    for line in heading(report):
        console.print(line, markup=False, soft_wrap=True)
    console.print()
    console.print(_table(report))
    for line in remarks(report):
        console.print(line, markup=False, soft_wrap=True)
    for sampling in report.sampling:
        console.print()
        head = "the whole system, cells and messages included, as the control period shrinks"
        console.print(
            f"{sampling.wheels}: {head}; errors from {sampling.against}", markup=False, soft_wrap=True
        )
        console.print(_sampling(sampling))


def heading(report: AccuracyReport) -> list[str]:
    """Format the study's heading: scene and reference."""
    reference = report.reference
    found = [
        (
            f"scene {report.scene}: {report.duration_s:g} s, {plural(report.cells, 'cell')}, "
            f"{plural(report.parcels, 'parcel')}, sampled every {report.period_s * 1e3:g} ms"
        ),
        f"reference: {reference.method}",
    ]
    found += [
        f"  {one.method}: {one.apart_m:.2g} m from it ({one.what}, to {one.until_s:.6g} s)"
        for one in reference.agreement
    ]
    return [*found, *(f"  {note}" for note in reference.notes)]


def metres(value: float | None) -> str:
    """Two digits and a power of ten."""
    return "–" if value is None else f"{value:.1e}"


def seconds(value: float | None) -> str:
    """``1.23 ms``, ``4.56 s``."""
    if value is None:
        return "–"
    return f"{value * 1e3:.3g} ms" if value < 0.9995 else f"{value:.3g} s"


def _milliseconds(value: float | None) -> str:
    """``1.23``, ``4,560``."""
    if value is None:
        return "–"
    return f"{value * 1e3:.3g}" if value < 0.9995 else f"{value * 1e3:,.0f}"


def events(row: AccuracyRow) -> str:
    """``86``, ``84 −2 +3``: found, missed and invented."""
    if row.events_found is None:
        return "–"
    missed = f" −{row.events_missed}" if row.events_missed else ""
    invented = f" +{row.events_invented}" if row.events_invented else ""
    return f"{row.events_found}{missed}{invented}"


def _table(report: AccuracyReport) -> Table:
    table = Table(box=None, pad_edge=False)
    table.add_column("solver", style="cyan", no_wrap=True)
    table.add_column("", no_wrap=True)
    chatter = report.reference.chatter_s is not None
    before = ("before chatter",) if chatter else ()
    for name in ("error, m", *before, "at end, m", "events", "times, s", "wall, ms", "shortest–longest"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("s/s", justify="right", no_wrap=True)
    table.add_column("steps", justify="right", no_wrap=True)
    for row in report.rows:
        if row.status == "omitted":
            continue
        if row.error_max is None:
            table.add_row(row.solver, row.setting, row.status)
            continue
        spread = f"{_milliseconds(row.wall_low_s)}–{_milliseconds(row.wall_high_s)}"
        table.add_row(
            row.solver,
            row.setting,
            metres(row.error_max),
            *([metres(row.error_before)] if chatter else []),
            metres(row.error_end),
            events(row),
            metres(row.event_time_error),
            _milliseconds(row.wall_s),
            spread,
            f"{row.speed:,.0f}" if row.speed is not None and row.speed >= 10.0 else f"{row.speed:.2g}",
            f"{row.effort:,}",
        )
    return table


def remarks(report: AccuracyReport) -> list[str]:
    """Format remarks below the table: omissions, failures, and divergent orders of events."""
    found = ["", _KEY]
    found += list(
        dict.fromkeys(f"{row.line} {row.note}." for row in report.rows if row.note and row.status == "ok")
    )
    judged = {
        row.solver: row.judged_by
        for row in report.rows
        if row.judged_by not in (None, report.reference.solver)
    }
    found += [f"{name} is judged by {judge}, not by itself." for name, judge in judged.items()]
    found += [
        f"{row.solver} {row.setting}: order of events differs from {row.order_until:.4g} s on "
        f"({metres(row.error_before)} m before, {metres(row.error_end)} m at the end"
        + (
            f", speeds' distributions {row.speed_distance:.2g} apart after)."
            if row.speed_distance is not None
            else ")."
        )
        for row in report.rows
        if row.order_until is not None
    ]
    return [*found, *_left_out(report)]


def _left_out(report: AccuracyReport) -> list[str]:
    """List rows without figures and the reason, grouped by line and reason."""
    settings: dict[tuple[str, str], list[str]] = {}
    for row in report.rows:
        if row.status != "ok":
            before = "" if row.error_before is None else f" ({metres(row.error_before)} m before chatter)"
            value = "" if row.value is None else f"{row.value:g}"
            settings.setdefault((row.line, f"{row.status}: {row.reason}{before}"), []).append(value)
    return [
        " ".join([line, ", ".join(values)]).strip() + f": {why}" for (line, why), values in settings.items()
    ]


def _sampling(sampling: Sampling) -> Table:
    table = Table(box=None, pad_edge=False)
    for name in ("period", "error, m", "wall time"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("")
    for row in sampling.rows:
        said = "" if row.status == "ok" else f"{row.status}: {row.reason}"
        table.add_row(seconds(row.period_s), metres(row.error_max), seconds(row.wall_s), said)
    return table


def answer(report: AccuracyReport, target_m: float) -> str:
    """The cheapest solver and setting that reaches a target, in one line."""
    row = report.cheapest(target_m)
    if row is not None:
        return (
            f"{row.solver} with {row.setting} reaches {target_m:g} m in {seconds(row.wall_s)}: "
            f"{metres(row.error_max)} m off over {report.duration_s:g} s of {report.scene}"
        )
    best = report.most_accurate()
    if best is None:
        return f"no solver completed {report.scene}"
    return (
        f"no setting reaches {target_m:g} m on {report.scene}; the nearest is {best.solver} with {best.setting}: "
        f"{metres(best.error_max)} m in {seconds(best.wall_s)}"
    )
