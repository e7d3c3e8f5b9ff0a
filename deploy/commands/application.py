"""The ``mdms`` command line: help, and commands that are imported on demand."""

from __future__ import annotations

import importlib
import inspect
import os
import re
from collections.abc import Sequence
from typing import Annotated, Any

import typer

COMMANDS = {
    "run": "Run the whole system: cells with their firmware, the plant, messages between them.",
    "simulate": "Simulate the plant alone, with wheel speeds straight from the scene's field.",
    "accuracy": "Measure the cost of accuracy in time: every solver against a reference.",
    "plant": "Run the plant of a scene, for cells that are started elsewhere.",
    "cells": "Run the cells of one shard, for a plant that is started elsewhere.",
    "campaign": "Run a scene over seeds, faults and parameters: one table, one plot.",
    "check-firmware": "Check what makes a program depend on how it is run.",
    "control": "Pause, step, speed up, reset or stop a running system.",
    "check": "Search for faults that break a protocol's conditions, exhaustively in small worlds.",
    "constants": "Print the constants of motion of a pose: equilibrium, loads, torque.",
    "diff": "Compare two recordings: the first tick, cell and quantity that differ.",
    "export": "Write a recording in the formats of other tools: netCDF, Parquet, CSV, Foxglove.",
    "fault": "Inject a fault into a running system, or repair a fault.",
    "effects": "Show additions, cost and influence of every effect; a ladder of fidelity.",
    "info": "Print the contents of a recording.",
    "keys": "Make certificates and permissions of a run's processes.",
    "orientations": "Compute the angles at which a parcel comes to rest, exactly; maps over sizes.",
    "plot": "Plot a recording.",
    "registers": "Read the registers of a running system's cells.",
    "router": "Run a router between plant and cells on several hosts.",
    "scenes": "List the bundled scenes, or print a scene.",
    "schema": "Print the JSON Schema of scene files, for editors.",
    "status": "Print who takes part in a run, its tick and lag, who is missing or lost.",
    "step": "Step a cell's program again in a tick of a recording, in the debugger.",
    "view": "Show a run in progress or a recording in the browser: run, pause, step, break cells.",
    "warm": "Compile the kernels of scenes ahead of their first run.",
}
"""Every command and its line in the list; command NAME is function NAME of ``deploy.commands.NAME``,
with ``_`` for ``-``."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)

_OPTIONAL_VALUES = {
    "--realtime": ("1", _NUMBER),
    "--protocol-report": ("1", re.compile(r"[+-]?\d+")),
    "--messages": ("1", re.compile(r"[+-]?\d+")),
    "--trace-messages": ("all", re.compile(r"[^-].*")),
    "--registers": ("1", re.compile(r"[+-]?\d+")),
    "--check": ("stop", re.compile(r"stop|count")),
    "--docs": ("docs", re.compile(r"[^-].*")),
}
"""Options with an optional value: the value when the option stands alone, and the pattern of a given value."""

_COMPLETING = "_MDMS_COMPLETE"
"""Environment variable by which a shell asks for completions, in place of running a command."""

_HELP = """A Modular Distributed Manipulator System in software.

A fixed array of cells with two orthogonal wheels each carries flat parcels across it. Every cell runs its own
firmware and exchanges messages with its four neighbours. The plant moves the parcels.
"""

_EXAMPLES = (
    ("Run a bundled scene; write a recording and a plot:", "mdms run elliptic"),
    ("Simulate this motion without cells, at a fine tolerance:", "mdms simulate elliptic --tolerance 1e-12"),
    ("Change any value of a scene:", "mdms run heat --duration 2 --set cells.period_s=0.008192"),
    ("Write your own scene:", "mdms scenes elliptic > mine.toml; mdms run mine.toml"),
    ("Show options and examples of a command:", "mdms run --help"),
)

_EXIT_STATUS = (
    "Exit status: 0 done; 1 failed or stalled, see the last line of stderr; 2 bad input, nothing started; "
    "3 numerically unstable; 130 interrupted."
)


def fill_flag_values(arguments: Sequence[str]) -> list[str]:
    """Return the arguments, with the values of options that stand alone filled in."""
    given = list(arguments)
    for i, argument in enumerate(arguments):
        following = arguments[i + 1] if i + 1 < len(arguments) else ""
        if argument in _OPTIONAL_VALUES:
            value, pattern = _OPTIONAL_VALUES[argument]
            if not pattern.fullmatch(following):
                given[i] = f"{argument}={value}"
    return given


def application(arguments: Sequence[str]) -> typer.Typer:
    """Return the command line. Only the command named in the arguments is imported."""
    app = typer.Typer(
        name="mdms",
        help=_flowing(_HELP),
        epilog=_epilog(),
        no_args_is_help=True,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_top)
    words = arguments if _COMPLETING not in os.environ else _words_to_complete()
    wanted = next((word for word in words if not word.startswith("-")), None)
    for name, summary in COMMANDS.items():
        function: Any = _function(name) if name == wanted else _not_imported
        app.command(name, short_help=summary, help=_flowing(function.__doc__ or ""))(function)
    return app


def _words_to_complete() -> list[str]:
    """Return the words after the program's name on the command line to be completed."""
    line = os.environ.get("_TYPER_COMPLETE_ARGS") or os.environ.get("COMP_WORDS", "")
    return line.split()[1:]


def _epilog() -> str:
    examples = [f"{words}\n[cyan]  {command}[/cyan]" for words, command in _EXAMPLES]
    return "\n\n".join(["[bold]Examples[/bold]", *examples, _EXIT_STATUS])


def _flowing(text: str) -> str:
    """Paragraphs without line breaks, so that the terminal's width breaks them; indented lines stay."""
    return re.sub(r"(?<!\n)\n(?=\S)", " ", inspect.cleandoc(text))


def _print_version(wanted: bool) -> None:
    if not wanted:
        return
    from importlib import metadata

    try:
        number = metadata.version("mdms-emulator")
    except metadata.PackageNotFoundError:
        number = "(not installed)"
    typer.echo(f"mdms {number}")
    raise typer.Exit


_Version = Annotated[
    bool, typer.Option("--version", help="Print the version.", is_eager=True, callback=_print_version)
]


def _top(*, version: _Version = False) -> None:
    del version  # answered before it gets here


def _function(name: str) -> Any:
    module = name.replace("-", "_")
    return getattr(importlib.import_module(f"deploy.commands.{module}"), module)


def _not_imported() -> None:
    raise AssertionError("this is a bug: a command was called that had not been imported")
