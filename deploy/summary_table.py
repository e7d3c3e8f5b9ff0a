"""The outcome of a run as tables for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from math import hypot
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from deploy.summary import ParcelOutcome, Summary

_STYLES = {"ok": "bold green", "interrupted": "bold yellow"}
_MANY = 12
"""Parcels listed one by one; of more, the table says how many are in each state."""


def print_summary(summary: Summary, console: Console) -> None:
    """Print what was run, how it went and where the parcels are."""
    from rich.text import Text

    heading = Text.assemble(
        (summary.scene, "bold"), "  ", (summary.status, _STYLES.get(summary.status, "bold red"))
    )
    if summary.reason:
        heading.append(f"  {summary.reason}")
    console.print(heading)
    console.print(_facts(summary))
    if 0 < len(summary.parcels) <= _MANY:
        console.print(_parcels(summary.parcels))


def _facts(summary: Summary) -> Table:
    from rich.table import Table

    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", no_wrap=True)
    grid.add_column(overflow="fold")
    for name, value in _lines(summary):
        grid.add_row(name, value)
    return grid


def _lines(summary: Summary) -> list[tuple[str, str]]:
    """Name and text of each fact worth a line."""
    lines = [
        ("simulated", f"{summary.simulated_s:g} of {summary.duration_s:g} s in {summary.ticks:,} ticks"),
        ("wall time", _wall(summary)),
        ("cells", _cells(summary)),
        ("solver", _solver(summary)),
        ("supports", f"changed {summary.support_changes:,} times"),
    ]
    messages = summary.messages
    if messages.sent or messages.lost:
        trouble = "".join(
            f", {number:,} {name}"
            for name, number in (("lost", messages.lost), ("late", messages.late))
            if number
        )
        lines.append(("messages", f"{messages.sent:,} sent, {messages.delivered:,} delivered{trouble}"))
    if summary.faults:
        lines.append(("faults", ", ".join(f"{f['kind']} at {f['time_s']:g} s" for f in summary.faults[:6])))
    if summary.cells_lost:
        lines.append(("cells lost", _cell_names(summary.cells_lost)))
    if len(summary.parcels) > _MANY:
        lines.append(("parcels", _states(summary.parcels)))
    if summary.digest:
        lines.append(("digest", summary.digest))
    if summary.output:
        lines.append(("output", summary.output))
    return lines


def _wall(summary: Summary) -> str:
    text = f"{summary.wall_s:.3g} s after {summary.startup_s:.2g} s of start-up"
    if summary.ticks_per_s is not None and summary.realtime_factor is not None:
        text += f"; {summary.ticks_per_s:,.0f} ticks/s, {summary.realtime_factor:.3g} times real time"
    return text


def _cells(summary: Summary) -> str:
    if summary.transport is None:
        return f"{summary.cells:,}, wheel speeds straight from the field"
    where = "in this process" if summary.processes == 0 else f"in {summary.processes:,} processes"
    if summary.processes == 1:
        where = "in 1 process"
    return f"{summary.cells:,} {where} over {summary.transport}"


def _solver(summary: Summary) -> str:
    settings = [
        f"{name} {value:g}" for name, value in summary.solver.items() if isinstance(value, float | int)
    ]
    return ", ".join([str(summary.solver.get("name", "")), *settings])


def _cell_names(cells: Sequence[tuple[int, int]]) -> str:
    named = " ".join(f"{row},{column}" for row, column in cells[:20])
    return named if len(cells) <= 20 else f"{named} and {len(cells) - 20:,} more"


def _states(parcels: Sequence[ParcelOutcome]) -> str:
    counts = Counter(parcel.state for parcel in parcels)
    return ", ".join(f"{number:,} {state.replace('_', ' ')}" for state, number in counts.most_common())


def _parcels(parcels: Sequence[ParcelOutcome]) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    table.add_column("parcel", justify="right")
    for name in ("x (m)", "y (m)", "angle (rad)"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("state")
    for index, parcel in enumerate(parcels):
        x, y = parcel.position_m
        table.add_row(str(index), f"{x:.6f}", f"{y:.6f}", f"{parcel.angle_rad:.6f}", _state(parcel))
    return table


def _state(parcel: ParcelOutcome) -> str:
    text = parcel.state.replace("_", " ")
    if parcel.state == "moving":
        text += f" at {hypot(*parcel.velocity_m_s):.3g} m/s, {parcel.angular_velocity_rad_s:.3g} rad/s"
    else:
        text += f" since {parcel.time_s:.4f} s"
    return f"{text}: {parcel.detail}" if parcel.detail else text
