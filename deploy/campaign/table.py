"""A campaign in words for a terminal."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.console import Console
from rich.table import Table

from deploy.campaign.report import criterion_words
from deploy.words import counted, short

if TYPE_CHECKING:
    from deploy.campaign.grid import Axis
    from deploy.campaign.report import Report
    from deploy.campaign.statistics import Mean, Share

_WIDEST = 1000
"""Columns of any table."""

_FAILED = 5
"""Failed runs that are told; the others are in ``runs.jsonl``."""


def print_report(report: Report) -> None:
    """Print a row a case, and the first runs that failed."""
    console, table = Console(highlight=False), _table(report)
    needed = console.measure(table, options=console.options.update(max_width=_WIDEST)).maximum
    if console.width < needed:  # a line too long is better than a number cut off
        console = Console(highlight=False, width=needed)
    console.print(heading(report), markup=False, soft_wrap=True)
    console.print(f"success: {criterion_words(report.cases)}", markup=False, soft_wrap=True)
    console.print()
    console.print(table)
    failed = list(report.failed())
    if failed:
        console.print(f"\n{counted(len(failed), 'run')} failed:")
    for values, seed, outcome in failed[:_FAILED]:
        said = ", ".join([*(f"{key} {value_of(value)}" for key, value in values.items()), f"seed {seed}"])
        console.print(f"  {said}: {outcome.status}: {outcome.reason}", markup=False, soft_wrap=True)
    if len(failed) > _FAILED:
        console.print(f"  and {len(failed) - _FAILED:,} more")
    lost = sum(row.cells_lost for row in report.rows)
    if lost:
        console.print(
            f"\n{counted(lost, 'cell')} were lost though no fault struck them: programs that raised, or did not answer "
            "in time."
        )


def heading(report: Report) -> str:
    """What was run, in one line."""
    asked, cases = report.asked, report.cases
    facts = [f"scene {asked.scene}"]
    if asked.fault:
        until = "" if asked.until_s is None else f" to {asked.until_s:g} s"
        facts.append(f"fault {asked.fault} from {asked.at_s:g} s{until}")
    beside = f" and {cases.undisturbed_runs:,} undisturbed" if cases.undisturbed_runs else ""
    facts += [counted(len(cases.seeds), "seed"), counted(len(report.outcomes), "run") + beside]
    return f"{', '.join(facts)}; in brackets {100 * asked.confidence:g} % confidence intervals"


def _table(report: Report) -> Table:
    table = Table(box=None, pad_edge=False)
    for axis in report.cases.axes:
        table.add_column(_heading(axis, report), style="cyan", justify="right", no_wrap=True)
    for name in ("runs", "failed", "success, %", "error, m", "time, s"):
        table.add_column(name, justify="right", no_wrap=True)
    for row in report.rows:
        table.add_row(
            *(value_of(value) for value in row.values.values()),
            str(row.runs),
            str(row.failed),
            share_text(row.success),
            mean_text(row.error_m, row.runs),
            mean_text(row.time_s, row.runs),
        )
    return table


def _heading(axis: Axis, report: Report) -> str:
    """The last part of a key, where that tells which it is."""
    name = str(axis.path[-1])
    alike = [other for other in report.cases.axes if other.path[-1] == axis.path[-1]]
    return axis.key if len(alike) > 1 or name.isdigit() else name


def value_of(value: Any) -> str:
    """A varied value as short as it can be."""
    return short(value) if isinstance(value, float) else str(value)


def share_text(share: Share) -> str:
    """``90 (72–97)``, per cent."""
    if share.share is None:
        return "–"
    text = f"{100 * share.share:.0f}"
    return (
        text
        if share.low is None or share.high is None
        else f"{text} ({100 * share.low:.0f}–{100 * share.high:.0f})"
    )


def mean_text(mean: Mean, runs: int) -> str:
    """``0.12 (0.1–0.14)``; of how many, where that isn't of all runs."""
    if mean.mean is None:
        return "–"
    text = short(mean.mean)
    if mean.low is not None and mean.high is not None:
        text += f" ({short(mean.low)}–{short(mean.high)})"
    return text if mean.runs == runs else f"{text} of {mean.runs}"
