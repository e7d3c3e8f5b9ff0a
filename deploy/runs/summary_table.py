"""Summary of a run as tables for people."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import groupby
from math import hypot
from operator import itemgetter
from typing import TYPE_CHECKING, Any

from deploy.faults.records import describe_faults as lines_of
from deploy.util.formatting import plural

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from deploy.runs.summary import ParcelOutcome, Summary
    from plant.observations import TrafficCount, Transit

_STYLES = {"ok": "bold green", "interrupted": "bold yellow"}
_MANY = 12
"""Parcels listed one by one; of more, the table says how many are in each state."""
_NARROW = 60
"""Width of a terminal, in characters, from which a parcel's numbers fit beside each other."""
_FAULTS = 4
"""Faults named one by one."""
_NOTHING = 1e-12
"""What rounding leaves of a parcel's turning, rad/s."""


def print_summary(summary: Summary, console: Console) -> None:
    """Print the summary of a run and the states of its parcels."""
    from rich.text import Text

    heading = Text.assemble(
        (summary.scene, "bold"), "  ", (summary.status, _STYLES.get(summary.status, "bold red"))
    )
    if summary.reason:
        heading.append(f"  {summary.reason.removeprefix(f'{summary.status} ')}")
    console.print(heading)
    console.print(_facts(_lines(summary)))
    if summary.protocol is not None:
        from deploy.protocol_report.output import report_lines

        console.print("\n[bold]protocol[/bold]")
        console.print(_facts(report_lines(summary.protocol)))
    if 0 < len(summary.parcels) <= _MANY:
        console.print()
        narrow = console.width < _NARROW
        console.print(_facts(_parcel_lines(summary.parcels)) if narrow else _parcels(summary.parcels))


def _facts(lines: Iterable[tuple[str, str]]) -> Table:
    from rich.table import Table

    grid = Table.grid(padding=(0, 2))
    grid.add_column(style="dim", no_wrap=True)
    grid.add_column(overflow="fold")
    for name, value in lines:
        grid.add_row(name, value)
    return grid


def _lines(summary: Summary) -> list[tuple[str, str]]:
    """Return name and text of each line of the summary."""
    lines = [
        (
            "simulated",
            f"{summary.simulated_s:g} of {summary.duration_s:g} s in {plural(summary.ticks, 'tick')}",
        ),
        ("wall time", _wall(summary)),
        ("cells", _cells(summary)),
        *_firmware(summary),
        ("solver", _solver(summary)),
        ("supports", f"changed {summary.support_changes:,} times"),
        *_validity(summary),
    ]
    messages = summary.messages
    if messages.protocol is not None:
        protocol = messages.protocol
        lines.append(
            ("messages", f"{protocol.sent:,} sent by cells to neighbours, {protocol.received:,} received")
        )
    if messages.sent or messages.lost:
        trouble = "".join(
            f", {number:,} {name}"
            for name in ("lost", "late", "denied", "malformed")
            if (number := getattr(messages, name))
        )
        lines.append(
            ("frames", f"{messages.sent:,} sent on the bus, {messages.delivered:,} delivered{trouble}")
        )
    lines += _refused(summary.refused)
    lines += [("warning", warning) for warning in summary.warnings]
    lines += _effects(summary.effects)
    if summary.faults:
        lines.append(("faults", _faults(summary.faults)))
    if summary.cells_lost:
        lines.append(("cells lost", _cell_names(summary.cells_lost)))
    if len(summary.parcels) > _MANY:
        lines.append(("parcels", _states(summary.parcels)))
    if summary.feeders is not None:
        lines += _traffic(summary.feeders)
    if summary.digest:
        lines.append(("digest", summary.digest))
    if summary.motion_digest:
        lines.append(("motion", summary.motion_digest))
    if summary.output:
        lines.append(("output", summary.output))
    return lines


def _wall(summary: Summary) -> str:
    text = f"{summary.wall_s:.3g} s, start-up {summary.startup_s:.2g} s"
    if summary.ticks_per_s is not None and summary.realtime_factor is not None:
        factor = summary.realtime_factor
        times = f"{factor:,.0f}" if factor >= 100 else f"{factor:.3g}"
        text += f"; {summary.ticks_per_s:,.0f} ticks/s, {times} × real time"
    return text


def _cells(summary: Summary) -> str:
    if summary.transport is None:
        return f"{summary.cells:,}, wheel speeds straight from the field"
    processes = plural(summary.processes, "process", "processes") if summary.processes else "this process"
    where = f"in {processes}"
    return f"{summary.cells:,} {where} over {summary.transport}"


def _firmware(summary: Summary) -> list[tuple[str, str]]:
    if summary.firmware is None:
        return []
    name, form, size = (summary.firmware[key] for key in ("name", "form", "message_bytes"))
    return [
        (
            "firmware",
            f"{name}, {form}; " + (f"messages of {plural(int(size), 'byte')}" if size else "no messages"),
        )
    ]


def _solver(summary: Summary) -> str:
    settings = [
        f"{name} {value:g}" for name, value in summary.solver.items() if isinstance(value, float | int)
    ]
    return ", ".join([str(summary.solver.get("name", "")), *settings])


def _validity(summary: Summary) -> Iterator[tuple[str, str]]:
    """Yield lines on known limits of the result: left-out events, invalid friction law, captured chatter."""
    if summary.events_left_out:
        why = "too many of one parcel in one solver call; the time from which a law is not valid may be among them"
        yield "events", f"{summary.events_left_out:,} left out: {why}"
    if summary.law_not_valid:
        parcel, since_s = (summary.law_not_valid[0][key] for key in ("parcel", "since_s"))
        more = len(summary.law_not_valid) - 1
        others = f", and {plural(more, 'parcel')} later" if more else ""
        yield "law", f"not valid since {since_s:.4g} s: parcel {parcel} outruns a wheel{others}"
    if summary.captured is not None:
        numbers = [str(number) for number in summary.captured["parcels"]]
        whose = f"of parcel{'s' if len(numbers) > 1 else ''} {', '.join(numbers[:_MANY])}"
        if len(numbers) > _MANY:
            whose = f"of {len(numbers):,} parcels"
        capture_m = summary.captured["capture_m"]
        yield (
            "chatter",
            f"captured: positions {whose} are accurate to {capture_m:g} m (solver.capture_m), not to the tolerance",
        )


def _refused(rows: Sequence[Mapping[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yield a line for each rejected peer, with kinds and numbers of rejections."""
    for whose, own in groupby(sorted(rows, key=itemgetter("whose")), itemgetter("whose")):
        listed = (f"{row['what']} {row['why']} {row['number']:,} ×" for row in own)
        yield "refused", f"{whose}: {'; '.join(listed)}"


def _faults(faults: Sequence[Mapping[str, Any]]) -> str:
    listed = lines_of(faults)
    named = "; ".join(listed[:_FAULTS])
    return named if len(listed) <= _FAULTS else f"{named}; and {len(listed) - _FAULTS:,} more"


def _cell_names(cells: Sequence[tuple[int, int]]) -> str:
    named = " ".join(f"{row},{column}" for row, column in cells[:20])
    return named if len(cells) <= 20 else f"{named} and {len(cells) - 20:,} more"


def _states(parcels: Sequence[ParcelOutcome]) -> str:
    counts = Counter(parcel.state for parcel in parcels)
    return ", ".join(f"{number:,} {state.replace('_', ' ')}" for state, number in counts.most_common())


def _effects(effects: Mapping[str, int]) -> Iterator[tuple[str, str]]:
    """Yield a line for each effect of the cells, with its counters."""
    for effect, counts in groupby(effects.items(), lambda item: item[0].partition(".")[0]):
        listed = [(name.partition(".")[2].replace("_", " ").replace(".", " "), n) for name, n in counts]
        if effect == "faults":  # the faults are listed below; each has its own counters
            yield "by faults", ", ".join(f"{what} {number:,}" for what, number in listed)
        else:
            yield effect, ", ".join(f"{number:,} {what}" for what, number in listed)


def _traffic(count: TrafficCount) -> Iterator[tuple[str, str]]:
    """Yield name and text of the parcels fed by each feeder and leaving by each exit, with transit times."""
    for feeder in count.feed:
        text = f"{feeder.fed:,} fed, {feeder.waiting:,} waiting"
        if feeder.held_back:
            text += f"; {feeder.held_back:,} held back, up to {feeder.longest_hold_s:.3g} s"
        yield f"feeder {feeder.name}", text
    for one in count.exits:
        wrong = f", {one.misrouted:,} of them misrouted" if one.misrouted else ""
        yield f"exit {one.name}", f"{one.left:,} left" + _after(one.transit_s) + wrong
    if count.left and count.left_per_s is not None:
        yield "throughput", f"{count.left_per_s:.3g} parcels/s"


def _after(transit_s: Transit | None) -> str:
    if transit_s is None:
        return ""
    return f" after {transit_s.mean:.3g} s ({transit_s.shortest:.3g} to {transit_s.longest:.3g})"


def _parcels(parcels: Sequence[ParcelOutcome]) -> Table:
    from rich.table import Table

    table = Table(box=None, padding=(0, 2, 0, 0), header_style="dim")
    table.add_column("parcel", justify="right")
    for name in ("x (m)", "y (m)", "angle (rad)"):
        table.add_column(name, justify="right", no_wrap=True)
    table.add_column("state")
    for index, parcel in enumerate(parcels):
        x, y = parcel.position_m
        table.add_row(str(index), f"{x:.6f}", f"{y:.6f}", f"{parcel.angle_rad:.6f}", _state(parcel))
    return table


def _parcel_lines(parcels: Sequence[ParcelOutcome]) -> Iterator[tuple[str, str]]:
    for index, parcel in enumerate(parcels):
        x, y = parcel.position_m
        yield (
            f"parcel {index}",
            f"x {x:.6f} m, y {y:.6f} m, angle {parcel.angle_rad:.6f} rad; {_state(parcel)}",
        )


def _state(parcel: ParcelOutcome) -> str:
    text = parcel.state.replace("_", " ")
    if parcel.state == "moving":
        turning = parcel.angular_velocity_rad_s if abs(parcel.angular_velocity_rad_s) > _NOTHING else 0.0
        text += f", {hypot(*parcel.velocity_m_s):.2g} m/s, {turning:.2g} rad/s"
    else:
        text += f" since {parcel.time_s:.4f} s"
    return f"{text}: {parcel.detail}" if parcel.detail else text
