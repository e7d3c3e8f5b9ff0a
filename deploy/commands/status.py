"""``mdms status``: presence of cells, tick and lag of a run."""

from __future__ import annotations

import json
from typing import Annotated, Any

import typer

from deploy.commands.options import (
    JsonOption,
    OperatorKeysOption,
    RunningAsOption,
    RunningAtOption,
    TimeoutOption,
    target_of,
)

_LISTED = 12
"""Processes that are listed; further ones are counted."""


def status(
    *,
    connect: RunningAtOption = None,
    run: RunningAsOption = None,
    keys: OperatorKeysOption = None,
    timeout: TimeoutOption = 5.0,
    processes: Annotated[
        bool, typer.Option("--processes", help="List the processes of cells that are here.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Print who takes part in a run, its tick and lag, and who is lost.

    By default it asks the newest run below runs/, or else whoever listens where mdms plant does. The run answers at any
    time: while it waits for cells, and in the middle of a tick. Exit status 0: the plant answers, and nobody is
    missing; 1: somebody is missing or lost, or no plant answers. It serves as a probe.

    The newest run on this host; a plant or a router elsewhere; as a probe, after two seconds:

      [cyan]mdms status[/cyan]
      [cyan]mdms status --connect tcp/127.0.0.1:7447 --run heat[/cyan]
      [cyan]mdms status --connect tls/10.0.0.5:7447 --keys operator --timeout 2 --json[/cyan]
    """
    from deploy.control.client import ask_status
    from deploy.errors import DeployError, InputError

    try:
        endpoint, name = target_of(connect, run, keys)
        found = ask_status(endpoint, name, timeout, keys)
    except InputError as error:
        raise DeployError(str(error)) from None  # for a probe: exit status 1
    if as_json:
        print(json.dumps(found))
    else:
        _print(found, listed=processes)
    if found["missing"]:
        raise typer.Exit(1)


def _print(found: dict[str, Any], *, listed: bool) -> None:
    from rich.console import Console
    from rich.table import Table

    from deploy.util.formatting import plural

    console = Console(highlight=False)
    unit = "cells" if found["shards"] > 1 and _of_cells(found) else "shards"
    here = f"{found['here']:,} of {found['shards']:,} {unit} here"
    console.print(f"[bold]{found['run']}[/bold]  {found['state']}, {here}", soft_wrap=True)
    table = Table.grid(padding=(0, 2))
    table.add_row("tick", f"{found['tick']:,} ({found['time_s']:g} of {found['duration_s']:g} s)")
    table.add_row("lag", _lag(found))
    if found["missing"]:
        table.add_row("missing", _names(found["missing_shards"], found["missing"]))
    if found["lost"]:
        cells = " ".join(f"{row},{column}" for row, column in found["lost_cells"][:_LISTED])
        more = f" and {found['lost'] - _LISTED} more" if found["lost"] > _LISTED else ""
        table.add_row("lost", f"{found['lost']:,} cells: {cells}{more}")
    if listed:
        for one in found["processes"]:
            where = f"{one['host']}, process {one['pid']}" if "host" in one else ""
            table.add_row(_name(one), plural(one["cells"], "cell"), where)
    console.print(table)


def _lag(found: dict[str, Any]) -> str:
    """Describe how far the run is behind its clock, and whether a tick waits for somebody."""
    parts = [f"{found['lag_s']:.3g} s behind the clock"] if found.get("lag_s") else []
    if found["waits_for"]:
        names = ", ".join(map(str, found["waits_for"][:_LISTED]))
        parts.append(f"waits {found['waits_s']:.1f} s for shards {names}")
    return "; ".join(parts) or "none"


def _names(shards: list[dict[str, Any]], number: int) -> str:
    named = ", ".join(_name(one) for one in shards[:_LISTED])
    return f"{named} and {number - _LISTED} more" if number > _LISTED else named


def _of_cells(found: dict[str, Any]) -> bool:
    """Whether each cell has a process."""
    return all(_name(one).startswith("cell ") for one in (*found["processes"], *found["missing_shards"]))


def _name(shard: dict[str, Any]) -> str:
    """Name a shard: ``shard 3``, or ``cell 0,1`` where each cell has a process."""
    name = str(shard["name"])
    return name if name.startswith("cell ") else f"shard {shard['shard']}"
