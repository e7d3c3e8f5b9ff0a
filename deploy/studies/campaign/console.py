"""Terminal output of a campaign."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, final

from rich.console import Console
from rich.table import Table

from deploy.studies.campaign.report import criterion_words
from deploy.util.formatting import plural, short_number
from deploy.util.progress import LINE_S, Display

if TYPE_CHECKING:
    from rich.progress import Progress as Bar

    from deploy.studies.campaign.cases import Axis
    from deploy.studies.campaign.report import CampaignReport, Mean, Share


@final
class CampaignProgress(Display):
    """Progress bar with completed runs, failed runs and remaining time; occasional lines in a log.

    Args:
        total: Runs of the campaign, baseline runs included.
        done: Of these, done before.
        failed: Of those, failed.
        quiet: Show nothing.
    """

    def __init__(self, total: int, done: int, failed: int, *, quiet: bool) -> None:
        super().__init__(_bar, quiet=quiet)
        self._total, self._done, self._failed = total, done, failed
        self._before = done
        self._begun = self._said = time.monotonic()
        if self._bar is not None:
            self._task = self._bar.add_task("", total=total, completed=done, failed=self._facts())

    def advance(self, *, failed: bool) -> None:
        """Count one more completed run."""
        self._done += 1
        self._failed += failed
        if self._bar is not None:
            self._bar.update(self._task, completed=self._done, failed=self._facts())
        elif self._lines and time.monotonic() - self._said > LINE_S:
            self._said = time.monotonic()
            left_s = (self._said - self._begun) / (self._done - self._before) * (self._total - self._done)
            self._write(f"{self._done:,} of {self._total:,} runs{self._facts()}, {left_s:.0f} s left")

    def _facts(self) -> str:
        return f", {self._failed:,} failed" if self._failed else ""


def _bar() -> Bar:
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    return Bar(
        MofNCompleteColumn(),
        TextColumn("runs{task.fields[failed]}"),
        BarColumn(),
        TimeRemainingColumn(),
        TextColumn("left"),
        console=Console(stderr=True),
        transient=True,
    )


_WIDEST = 1000
"""Columns of any table."""

_FAILED = 5
"""Failed runs that are listed; the others are in ``runs.jsonl``."""


def print_report(report: CampaignReport) -> None:
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
        console.print(f"\n{plural(len(failed), 'run')} failed:")
    for values, seed, outcome in failed[:_FAILED]:
        said = ", ".join([*(f"{key} {value_of(value)}" for key, value in values.items()), f"seed {seed}"])
        console.print(f"  {said}: {outcome.status}: {outcome.reason}", markup=False, soft_wrap=True)
    if len(failed) > _FAILED:
        console.print(f"  and {len(failed) - _FAILED:,} more")
    lost = sum(row.cells_lost for row in report.rows)
    if lost:
        console.print(
            f"\n{plural(lost, 'cell')} were lost without a fault: their programs raised, or did not answer "
            "in time."
        )


def heading(report: CampaignReport) -> str:
    """Format the campaign's heading: scene, fault and number of runs."""
    spec, cases = report.spec, report.cases
    facts = [f"scene {spec.scene}"]
    if spec.fault:
        until = "" if spec.until_s is None else f" to {spec.until_s:g} s"
        facts.append(f"fault {spec.fault} from {spec.at_s:g} s{until}")
    beside = f" and {plural(cases.baseline_runs, 'baseline run')}" if cases.baseline_runs else ""
    facts += [plural(len(cases.seeds), "seed"), plural(len(report.outcomes), "run") + beside]
    return f"{', '.join(facts)}; in brackets {100 * spec.confidence:g} % confidence intervals"


def _table(report: CampaignReport) -> Table:
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


def _heading(axis: Axis, report: CampaignReport) -> str:
    """The last part of a key, where that is unique."""
    name = str(axis.path[-1])
    alike = [other for other in report.cases.axes if other.path[-1] == axis.path[-1]]
    return axis.key if len(alike) > 1 or name.isdigit() else name


def value_of(value: Any) -> str:
    """A varied value as short as it can be."""
    return short_number(value) if isinstance(value, float) else str(value)


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
    text = short_number(mean.mean)
    if mean.low is not None and mean.high is not None:
        text += f" ({short_number(mean.low)}–{short_number(mean.high)})"
    return text if mean.runs == runs else f"{text} of {mean.runs}"
