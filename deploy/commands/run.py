"""``mdms run``: the whole system, once."""

from __future__ import annotations

import contextlib
import json
import sys
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from deploy.commands.options import (
    DurationOption,
    JsonOption,
    OutputOption,
    SceneArgument,
    SeedOption,
    SetOption,
    SolverOption,
    ToleranceOption,
    load_scene,
)
from deploy.errors import InputError
from deploy.plan import Plan, Processes, RunOptions, plan

if TYPE_CHECKING:
    from deploy.scene import Scene

ProcessesOption = Annotated[
    str | None,
    typer.Option(
        "--processes",
        metavar="N|each|0",
        help="Worker processes for the cells; each: one a cell; 0: everything in this process.",
    ),
]
TransportOption = Annotated[
    Literal["zenoh", "memory"],
    typer.Option("--transport", help="What carries the messages; memory needs --processes 0."),
]
WireOption = Annotated[
    Literal["packed", "cells"] | None,
    typer.Option(
        "--wire",
        help="One array a worker, or one key a cell and link that any Zenoh tool can join. "
        "Default: packed, but cells with --processes each.",
    ),
]
ListenOption = Annotated[
    str | None,
    typer.Option(
        "--listen",
        metavar="ENDPOINT",
        help="Where the plant listens, such as tcp/127.0.0.1:7447. Default: a free loopback port.",
    ),
]
RealtimeOption = Annotated[
    float | None,
    typer.Option(
        "--realtime",
        metavar="[FACTOR]",
        help="Keep pace with the wall clock, or FACTOR times as fast. Default: as fast as it goes.",
    ),
]
PlanOption = Annotated[bool, typer.Option("--plan", help="Print what would be started, and exit.")]
PictureOption = Annotated[bool, typer.Option("--picture/--no-picture", help="Draw overview.png at the end.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="No progress and no warnings on stderr.")]


def run(
    scene: SceneArgument,
    *,
    sets: SetOption = None,
    seed: SeedOption = None,
    duration: DurationOption = None,
    solver: SolverOption = None,
    tolerance: ToleranceOption = None,
    processes: ProcessesOption = None,
    transport: TransportOption = "zenoh",
    wire: WireOption = None,
    listen: ListenOption = None,
    realtime: RealtimeOption = None,
    output: OutputOption = None,
    picture: PictureOption = True,
    show_plan: PlanOption = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> None:
    """Run a scene: every cell an agent with its own controller, the plant, and messages between them.

    Leaves recording.mcap, summary.json and overview.png in the output folder. Ctrl-C ends the run early; what
    was recorded is complete up to there.
    """
    found = load_scene(scene, sets, seed, duration, solver, tolerance)
    options = RunOptions(
        processes=parse_processes(processes),
        transport=transport,
        wire=wire,
        listen=listen,
        realtime=realtime,
        output=output,
        picture=picture,
    )
    if show_plan:
        print_plan(plan(found, options, "RUN"), as_json=as_json)
    else:
        raise typer.Exit(_run(found, options, as_json=as_json, quiet=quiet))


def _run(scene: Scene, options: RunOptions, *, as_json: bool, quiet: bool) -> int:
    from deploy.commands.outcome import report
    from deploy.interruption import Interrupted, Interruption
    from deploy.run import run as run_scene

    interruption = Interruption()
    with interruption.watching(last=True):
        try:
            # What a firmware prints in this process is no part of what the command prints.
            with contextlib.redirect_stdout(sys.stderr):
                outcome = run_scene(scene, options, quiet=quiet, interruption=interruption)
        except Interrupted as interrupted:
            sys.stderr.write("mdms: interrupted before the run began\n")
            return interrupted.exit_code
        return report(outcome, as_json=as_json)


def parse_processes(text: str | None) -> Processes | None:
    """The value of ``--processes``.

    Raises:
        InputError: Neither ``each`` nor a number of processes.
    """
    if text is None or text == "each":
        return text
    if text.isascii() and text.isdigit():
        return int(text)
    raise InputError(f"--processes {text}: must be each, or a number of processes from 0")


def print_plan(made: Plan, *, as_json: bool) -> None:
    """Print what would be started."""
    if as_json:
        print(json.dumps(made.as_json(), indent=2))
        return
    from rich.console import Console
    from rich.table import Table

    console = Console(highlight=False)
    plant, first = made.processes[0], made.processes[1]
    console.print(f"[bold]{made.scene}[/bold]  {made.transport}, wire form {made.wire}")
    table = Table.grid(padding=(0, 2))
    for process in made.processes:
        table.add_row(f"[cyan]{process.name}[/cyan]", process.where, _span(process.cells))
    console.print(table)
    if plant.listen is not None:
        console.print(f"The plant listens on {plant.listen}; the others connect to it.", soft_wrap=True)
    console.print(f"Cells are ready when: {first.ready}.", soft_wrap=True)
    console.print(f"The run begins when: {plant.ready}.", soft_wrap=True)


def _span(cells: tuple[tuple[int, int], ...]) -> str:
    """``18: 0,0 to 5,4``."""
    if not cells:
        return ""
    first, last = (f"{row},{column}" for row, column in (cells[0], cells[-1]))
    return first if len(cells) == 1 else f"{len(cells):,}: {first} to {last}"
