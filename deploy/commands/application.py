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
    "run": "The whole system: every cell an agent, the plant, messages between them.",
    "simulate": "The plant alone, wheel speeds straight from the scene's field.",
    "accuracy": "What accuracy costs in time: every solver against a reference.",
    "campaign": "Many runs over seeds, faults and parameters: one table, one picture.",
    "constants": "The constants of motion of a pose: equilibrium, loads, torque.",
    "fault": "A fault injected into a running system, or repaired.",
    "effects": "Every effect: what it adds, costs and changes; a ladder of fidelity.",
    "keys": "A run's certificates and who may do what: let nobody else in.",
    "orientations": "The angles at which a parcel comes to rest, exactly; maps over sizes.",
    "plot": "Pictures of a recording.",
    "registers": "What the cells of a running system show of themselves.",
    "scenes": "The bundled scenes, or one of them in full.",
    "schema": "The JSON Schema of a scene file, for editors.",
}
"""Every command and its line in the list; command NAME is function NAME of ``deploy.commands.NAME``."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)

_OPTIONAL_VALUES = {
    "--realtime": ("1", _NUMBER),
    "--protocol-report": ("1", re.compile(r"[+-]?\d+")),
    "--registers": ("1", re.compile(r"[+-]?\d+")),
    "--docs": ("docs", re.compile(r"[^-].*")),
}
"""Options that may stand without a value: what they mean then, and what a value looks like."""

_COMPLETING = "_MDMS_COMPLETE"
"""Environment variable by which a shell asks for completions, in place of running a command."""

_HELP = """A Modular Distributed Manipulator System in software.

A fixed array of cells with two orthogonal wheels each carries flat parcels across it. Every cell runs its own
firmware and talks to its four neighbours; the plant moves the parcels.
"""

_EXAMPLES = (
    ("A bundled scene, all of it; a recording and a picture at the end:", "mdms run elliptic"),
    ("The same motion without cells, as exact as it gets:", "mdms simulate elliptic --tolerance 1e-12"),
    ("Any value of a scene can be changed:", "mdms run heat --duration 2 --set cells.period_s=0.008192"),
    ("A scene of your own:", "mdms scenes elliptic > mine.toml; mdms run mine.toml"),
    ("Options and examples of a command:", "mdms run --help"),
)

_EXIT_STATUS = (
    "Exit status: 0 done; 1 failed or stalled, the last line says where; 2 bad input, nothing started; "
    "3 numerically unstable; 130 interrupted."
)


def fill_flag_values(arguments: Sequence[str]) -> list[str]:
    """The arguments, with the value that an option has when it stands alone."""
    given = list(arguments)
    for i, argument in enumerate(arguments):
        following = arguments[i + 1] if i + 1 < len(arguments) else ""
        if argument in _OPTIONAL_VALUES:
            value, pattern = _OPTIONAL_VALUES[argument]
            if not pattern.fullmatch(following):
                given[i] = f"{argument}={value}"
    return given


def application(arguments: Sequence[str]) -> typer.Typer:
    """The command line, with that command imported which the arguments ask for; the others are names only."""
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
    return getattr(importlib.import_module(f"deploy.commands.{name}"), name)


def _not_imported() -> None:
    raise AssertionError("this is a bug: a command was called that had not been imported")
