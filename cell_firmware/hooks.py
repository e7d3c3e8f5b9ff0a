"""Guard of the hooks that a run asks a program before it begins."""

from __future__ import annotations

import functools
import traceback
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Any, Final

from cell_firmware.errors import FirmwareError
from cell_firmware.firmware import Firmware

HOOKS: Final = (
    "check",
    "check_geometry",
    "required_effects",
    "uses_camera",
    "value_ranges",
    "warnings",
    "theory",
)
"""Methods of `cell_firmware.program.Program` that a run calls before its first tick."""


def guard(firmware: Firmware, name: str) -> None:
    """Have every hook of a program raise nothing but FirmwareError.

    Whatever a hook raises otherwise, SystemExit included, becomes a FirmwareError that names the firmware and the hook
    and ends with the traceback. The original error is its cause.

    Args:
        firmware: The program; its hooks are replaced on the instance, so that no caller can forget the guard.
        name: The firmware as the scene names it.
    """
    for hook in HOOKS:
        setattr(firmware, hook, _guarded(getattr(firmware, hook), name, f"{hook}()"))


@contextmanager
def refusals(name: str, what: str) -> Generator[None]:
    """Turn whatever an author's code raises in the context into a FirmwareError with the traceback.

    Args:
        name: The firmware as the scene names it.
        what: The part of the program that is run.

    Raises:
        FirmwareError: The code raised; a FirmwareError of its own is raised as it is.
    """
    try:
        yield
    except FirmwareError:  # a refusal in the author's own words
        raise
    except (Exception, SystemExit) as error:
        raise FirmwareError(f"firmware {name!r}: {what} raised {_line(error)}\n{_trace(error)}") from error


def _guarded(call: Callable[..., Any], name: str, what: str) -> Callable[..., Any]:
    @functools.wraps(call)
    def guarded(*arguments: Any, **named: Any) -> Any:
        with refusals(name, what):
            return call(*arguments, **named)

    return guarded


def _line(error: BaseException) -> str:
    said = str(error).strip().splitlines()
    return ": ".join([type(error).__name__, *said[:1]])


def _trace(error: BaseException) -> str:
    """The traceback from the author's hook on."""
    trace = traceback.TracebackException.from_exception(error)
    trace.stack = traceback.StackSummary.from_list([one for one in trace.stack if one.filename != __file__])
    return "".join(trace.format()).rstrip()
