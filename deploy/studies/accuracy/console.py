"""Terminal output of an accuracy study."""

from __future__ import annotations

from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table

from deploy.studies.accuracy.report import TARGETS_M
from deploy.util.formatting import plural
from deploy.util.tables import Column, print_columns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from deploy.studies.accuracy.report import AccuracyReport, AccuracyRow, Choice, Sampling

_KEY = (
    "error: largest displacement of any corner of a footprint. events: found −missed +invented; times: largest time "
    "error of found events. wall: median of a run as mdms simulate makes it, all settings in turns. ×: over the "
    "fastest row's. calls: processor time in calls of the solver, without sampling and bookkeeping. s/s: "
    "simulated seconds a second. steps: with scipy right-hand sides."
)
_MOST_TIES = 3
"""Settings that are listed as tied; more are counted."""


def print_report(report: AccuracyReport) -> None:
    """Print the verdict, the reference, every row, what was left out and why, and the price of sampling."""
    console = Console(highlight=False, soft_wrap=True)
    for line in (*verdict(report), "", *heading(report)):
        console.print(line, markup=False)
    console.print()
    narrow = print_columns(_columns(report))
    for line in remarks(report):
        console.print(line, markup=False)
    if narrow:
        console.print(f"left out, too wide for this terminal: {'; '.join(narrow)} (see --json)", markup=False)
    for sampling in report.sampling:
        console.print()
        head = "the whole system, cells and messages included, as the control period shrinks"
        console.print(f"{sampling.wheels}: {head}; errors from {sampling.against}", markup=False)
        console.print(_sampling(sampling))


def verdict(report: AccuracyReport) -> list[str]:
    """Name the cheapest solver and setting for usual targets; targets with the same answer share a line."""
    choices = report.verdict()
    if not choices:
        return [_unreached(report, TARGETS_M[0])]
    shared: list[list[Choice]] = []
    for choice in choices:
        before = shared[-1][-1] if shared else None
        if before is not None and before.row is choice.row and before.following is choice.following:
            shared[-1].append(choice)
        else:
            shared.append([choice])
    found = ["cheapest by error:"]
    for group in shared:
        targets = ", ".join(f"{choice.target_m:g}" for choice in group)
        found.append(f"  {targets} m: {_chosen(group[-1])}")
    missed = [f"{target_m:g} m" for target_m in TARGETS_M[len(choices) :]]
    if missed:
        found.append(f"  {', '.join(missed)}: no setting; the nearest is {_nearest(report)}")
    return [*found, *(f"  {line}" for line in [_unconfirmed(report, TARGETS_M[len(choices) - 1])] if line)]


def _unconfirmed(report: AccuracyReport, target_m: float) -> str:
    """Warn of a target below the difference between reference and check; empty for a confirmed target."""
    confirmed_m = report.reference.confirmed_m
    if confirmed_m is not None and confirmed_m <= target_m:
        return ""
    limit = "by no other method" if confirmed_m is None else f"to {metres(confirmed_m)} m only"
    return f"smaller errors rest on the reference alone, which is confirmed {limit}"


def _chosen(choice: Choice) -> str:
    """Format a choice: setting, time, error, ties and the next solver."""
    row = choice.row
    parts = [f"{row.solver} with {row.setting}, {seconds(row.wall_s)}, {metres(row.error_max)} m off"]
    if own := [one.wall_s for one in choice.ties if one.line == row.line and one.wall_s is not None]:
        spans = f"{seconds(min(own))} to {seconds(max(own))}" if len(own) > 1 else seconds(own[0])
        parts.append(f"{plural(len(own), 'finer setting')} can't be told apart in time ({spans})")
    if others := [one for one in choice.ties if one.line != row.line]:
        parts.append(f"A tie with {_listed(others)}")
    if (following := choice.following) is not None and row.wall_s:
        ratio = (following.wall_s or 0.0) / row.wall_s
        parts.append(f"Next is {following.solver} with {following.setting} at {_two(ratio)} times")
    return ". ".join(parts)


def _listed(rows: Sequence[AccuracyRow]) -> str:
    named = [f"{row.solver} {row.setting} ({seconds(row.wall_s)})" for row in rows[:_MOST_TIES]]
    more = len(rows) - _MOST_TIES
    return ", ".join(named) + (f" and {more} more" if more > 0 else "")


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


def adapter_words(library: str) -> str:
    """``adapter to scipy.integrate.solve_ivp, ...``."""
    return f"adapter to {library}, restarted at every event, with calls that include the adapter in Python"


def _columns(report: AccuracyReport) -> list[Column]:
    rows = [row for row in report.rows if row.status != "omitted"]

    def figures(
        of: Callable[[AccuracyRow], str], missing: Callable[[AccuracyRow], str] = lambda _: ""
    ) -> list[str]:
        return [missing(row) if row.error_max is None else of(row) for row in rows]

    found = [
        Column("solver", [row.solver for row in rows], justify="left", style="cyan"),
        Column("setting", [row.setting for row in rows], justify="left"),
        Column("error, m", figures(lambda row: metres(row.error_max), lambda row: row.status)),
        Column("before chatter", figures(lambda row: metres(row.error_before)), 3),
        Column("at end, m", figures(lambda row: metres(row.error_end)), 5),
        Column("events", figures(events), 2),
        Column("times, s", figures(lambda row: metres(row.event_time_error)), 5),
        Column("wall, ms", figures(lambda row: _milliseconds(row.wall_s))),
        Column(
            "shortest–longest",
            figures(lambda row: f"{_milliseconds(row.wall_low_s)}–{_milliseconds(row.wall_high_s)}"),
            4,
        ),
        Column("×", figures(lambda row: "–" if row.relative is None else _two(row.relative)), 1),
        Column("calls, ms", figures(lambda row: _milliseconds(row.solver_s)), 5),
        Column("s/s", figures(lambda row: "–" if row.speed is None else _two(row.speed)), 6),
        Column("steps", figures(lambda row: f"{row.effort:,}"), 6),
    ]
    chatter = report.reference.chatter_s is not None
    return [column for column in found if chatter or column.heading != "before chatter"]


def _two(value: float) -> str:
    """Two digits, or whole."""
    return f"{value:,.0f}" if value >= 10.0 else f"{value:.2g}"


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
    found += [f"{name}: {adapter_words(library)}." for name, library in report.adapters.items()]
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
    choice = report.cheapest(target_m)
    if choice is None:
        return _unreached(report, target_m)
    caution = _unconfirmed(report, target_m)
    found = f"{target_m:g} m over {report.duration_s:g} s of {report.scene}: {_chosen(choice)}"
    return f"{found}. {caution[0].upper()}{caution[1:]}" if caution else found


def _unreached(report: AccuracyReport, target_m: float) -> str:
    if report.most_accurate() is None:
        return f"no solver completed {report.scene}"
    return f"no setting reaches {target_m:g} m on {report.scene}; the nearest is {_nearest(report)}"


def _nearest(report: AccuracyReport) -> str:
    best = report.most_accurate()
    assert best is not None, "this is a bug: no row has an error"
    return f"{best.solver} with {best.setting}: {metres(best.error_max)} m in {seconds(best.wall_s)}"
