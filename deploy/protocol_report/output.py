"""Text output of a protocol report."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from deploy.util.files import atomic_write
from deploy.util.formatting import plural, short_number

if TYPE_CHECKING:
    from deploy.protocol_report.report import LinkLoad, ProtocolReport, ResidualHistory
    from deploy.protocol_report.residuals import Residuals


def write_csv(residuals: Residuals, path: Path) -> None:
    """Write a line a tick: of every residual its root mean square and its greatest number; empty where there is none.

    Raises:
        DeployError: It can't be written.
    """
    names = list(residuals.rms)
    columns = [column for name in names for column in (residuals.rms[name], residuals.most[name])]
    with atomic_write(path) as draft, draft.open("w", encoding="utf-8") as lines:
        lines.write(
            ",".join(["tick", *(f"{name}_{what}" for name in names for what in ("rms", "max"))]) + "\n"
        )
        for row, tick in enumerate(residuals.tick):
            numbers = (column[row] for column in columns)
            lines.write(",".join([str(tick), *("" if x != x else repr(x) for x in numbers)]) + "\n")


def report_lines(report: ProtocolReport) -> Iterator[tuple[str, str]]:
    """Name and text of each line."""
    often = "every tick" if report.every_ticks == 1 else f"every {report.every_ticks} ticks"
    yield "field", f"{report.observed} of {plural(report.cells, 'cell')}, {often}{_dead(report)}"
    for name, one in report.residuals.items():
        yield name, _history(one)
    if report.law is not None:
        yield "theory", report.law
    yield "verdict", report.verdict
    if report.links is not None:
        yield "links", _links(report.links)
    for note in report.notes:
        yield "note", note


def _dead(report: ProtocolReport) -> str:
    return f"; {report.cells_dead:,} died" if report.cells_dead else ""


def _history(one: ResidualHistory) -> str:
    settled = [
        f"{words} from tick {tick:,} on"
        for words, tick in (("1 %", one.settled_1_percent_tick), ("1e-6", one.settled_1e6_tick))
        if tick is not None and one.greatest_rms > 0.0
    ]
    of_greatest = f"; at most {', '.join(settled)}" if settled else ""
    return (
        f"rms at most {_number(one.greatest_rms)}, at the end {_number(one.last_rms)} "
        f"(greatest {_number(one.last_max)}){of_greatest}"
    )


def _number(value: float) -> str:
    return f"{value:.3g}"


def _links(load: LinkLoad) -> str:
    filled = f"{100 * load.line_load:.3g} % of the capacity of a line at {load.baud:,} baud"
    return (
        f"{short_number(load.sent_per_cell_tick)} messages a cell and tick sent, "
        f"{short_number(load.received_per_cell_tick)} received; {load.line_bytes} bytes each on a serial line, "
        f"{short_number(load.line_bytes_per_cell_tick)} a cell and tick: "
        f"{filled}{'' if load.on_lines else ', if the scene had serial lines'}"
    )
