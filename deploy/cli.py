"""Entry point of ``mdms``: installs signal handlers before slow imports, and turns errors into messages."""

from __future__ import annotations

import gc
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import FrameType

_THRESHOLDS = (50_000, 20, 20)
"""Of the garbage collector: nearly all objects of an import stay, and looking through them takes a quarter of it."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``mdms``.

    Args:
        arguments: What follows ``mdms`` on the command line; default: this process's.

    Returns:
        The exit status.
    """
    thresholds = gc.get_threshold()
    gc.set_threshold(*_THRESHOLDS)
    _open_closed_streams()
    before = _leave_on_signals()
    try:
        return _run(sys.argv[1:] if arguments is None else arguments)
    finally:
        gc.set_threshold(*thresholds)
        if arguments is None:
            gc.freeze()  # the process ends: searching its objects for garbage would take a quarter of a second
        for number, handler in before.items():
            if signal.getsignal(number) is _leave:  # else a command has had the last word on it
                signal.signal(number, handler)


def _run(arguments: Sequence[str]) -> int:
    from deploy.commands.application import application, fill_flag_values
    from deploy.util.encodings import refusal_of, spell_unencodable
    from deploy.util.signals import Interrupted, Interruption

    spell_unencodable()
    if (refusal := refusal_of(arguments)) is not None:
        sys.stderr.write(f"{refusal}\n")
        return 2
    given = fill_flag_values(arguments)
    interruption = Interruption()
    try:
        command = application(given)
        with interruption.handling(), interruption.interruptible():
            try:
                command(given, prog_name="mdms")
            finally:
                sys.stdout.flush()  # here, where a failure can still be told
    except SystemExit as end:  # typer's way to end, well or with a usage error
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    except Interrupted as interrupted:
        sys.stderr.write("mdms: interrupted\n")
        return interrupted.exit_code
    except Exception as error:  # noqa: BLE001 - the last place that can say what went wrong
        return _report(error)
    return 0


def _open_closed_streams() -> None:
    """Open standard streams that are closed on the null device: files opened later would take their numbers."""
    while (number := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(number, True)
    os.close(number)
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open("r" if name == "stdin" else "w"))  # noqa: SIM115 - until the end


def _leave_on_signals() -> dict[int, Any]:
    """Let Ctrl-C and SIGTERM end the process at once until `Interruption` handles them; return the old handlers."""
    try:
        return {number: signal.signal(number, _leave) for number in (signal.SIGINT, signal.SIGTERM)}
    except ValueError:  # signals are for the main thread
        return {}


def _leave(number: int, frame: FrameType | None) -> None:
    """End the process at once: nothing has started, and an import could swallow an exception."""
    del number, frame
    os.write(2, b"mdms: interrupted\n")
    os._exit(130)


def _report(error: Exception) -> int:
    """Print an error on stderr, and return the exit status."""
    if isinstance(error, OSError) and error.filename is None and (failure := _stdout_failure()) is not None:
        if not isinstance(failure, BrokenPipeError):  # else the reader, as head, has what it wanted
            sys.stderr.write(f"mdms: can't write to stdout: {failure.strerror}\n")
        return 1
    status = _status(error)
    if status is not None:
        sys.stderr.write(f"{error}\n")
        return status
    import traceback

    traceback.print_exception(error)
    sys.stderr.write(f"mdms: this is a bug, please report it with the lines above: {error!r}\n")
    return 1


def _stdout_failure() -> OSError | None:
    """Return the error of writing to stdout; None if stdout can be written.

    Later text is dropped: the interpreter would fail again at its end.
    """
    try:
        sys.stdout.write("\n")  # a failed write is forgotten: only another one shows the failure
        sys.stdout.flush()
    except OSError as error:
        null = os.open(os.devnull, os.O_WRONLY)
        os.dup2(null, sys.stdout.fileno())
        os.close(null)
        return error
    return None


def _status(error: Exception) -> int | None:
    """Return the exit status of an error that a user can act on; None for all others, which are bugs."""
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
