"""The command ``mdms``: imports only what is asked for; every error ends in words and an exit status."""

from __future__ import annotations

import importlib
import inspect
import re
import signal
import sys
import threading
import traceback
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any

import typer

COMMANDS = {
    "run": "The whole system: every cell an agent, the plant, messages between them.",
    "simulate": "The plant alone, wheel speeds straight from the scene's field.",
    "constants": "The constants of motion of a pose: equilibrium, loads, torque.",
    "plot": "Pictures of a recording.",
    "scenes": "The bundled scenes, or one of them in full.",
    "schema": "The JSON Schema of a scene file, for editors.",
}
"""Every command and its line in the list; command NAME is function NAME of ``deploy.commands.NAME``."""

_ALONE = {"--realtime": "1"}
"""Options that may stand without a value, and what they mean then."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?", re.IGNORECASE)

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


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``mdms``.

    Args:
        arguments: What follows ``mdms`` on the command line; default: this process's.

    Returns:
        The exit status.
    """
    given = _completed(sys.argv[1:] if arguments is None else arguments)
    try:
        with _sigterm_as_interrupt():
            application(given)(given, prog_name="mdms")
    except SystemExit as end:  # typer's way to end, well or with a usage error
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    except KeyboardInterrupt:
        typer.echo("mdms: interrupted", err=True)
        return 130
    except Exception as error:  # noqa: BLE001 - the last place that can say what went wrong
        return _report(error)
    return 0


def _completed(arguments: Sequence[str]) -> list[str]:
    """The arguments, with the value that an option has when it stands alone."""
    completed = list(arguments)
    for i, argument in enumerate(arguments):
        following = arguments[i + 1] if i + 1 < len(arguments) else ""
        if argument in _ALONE and not _NUMBER.fullmatch(following):
            completed[i] = f"{argument}={_ALONE[argument]}"
    return completed


@contextmanager
def _sigterm_as_interrupt() -> Generator[None]:
    """SIGTERM ends whatever a command does as Ctrl-C would, unless the command handles it itself."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        if signal.getsignal(signal.SIGTERM) is signal.default_int_handler:
            signal.signal(signal.SIGTERM, before)


def application(arguments: Sequence[str]) -> typer.Typer:
    """The command line, with that command imported which the arguments ask for; the others are names only."""
    app = typer.Typer(
        name="mdms",
        help=_flowing(_HELP),
        epilog=_epilog(),
        no_args_is_help=True,
        add_completion=False,
        pretty_exceptions_enable=False,
        rich_markup_mode="rich",
        context_settings={"help_option_names": ["-h", "--help"]},
    )
    app.callback()(_top)
    wanted = next((argument for argument in arguments if not argument.startswith("-")), None)
    for name, summary in COMMANDS.items():
        function: Any = _function(name) if name == wanted else _not_imported
        app.command(name, short_help=summary, help=_flowing(function.__doc__ or ""))(function)
    return app


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


def _report(error: Exception) -> int:
    """Say what went wrong on stderr; the exit status."""
    status = _status(error)
    if status is not None:
        typer.echo(error, err=True)
        return status
    traceback.print_exception(error)
    typer.echo(f"mdms: this is a bug, please report it with the lines above: {error!r}", err=True)
    return 1


def _status(error: Exception) -> int | None:
    """The exit status of an error that a user can act on; None for all others, which are bugs."""
    from bus.errors import BusError
    from cell_firmware.errors import FirmwareError, FirmwareFailed
    from deploy.errors import DeployError
    from plant.errors import PlantError

    if isinstance(error, DeployError):
        return error.exit_code
    if isinstance(error, BusError | FirmwareFailed):
        return 1
    if isinstance(error, FirmwareError | PlantError):
        return 2
    return None


if __name__ == "__main__":
    sys.exit(main())
