"""Python's ``breakpoint()`` in a cell's program: the debugger takes the terminal of the command.

Worker processes have neither standard input nor a controlling terminal: Ctrl-C is for the main process alone. They
open the terminal by its name, which they inherit in an environment variable.
"""

from __future__ import annotations

import os
import sys
from typing import Any, Final

_VARIABLE: Final = "MDMS_TERMINAL"


def terminal_variable() -> dict[str, str]:
    """Return the environment variable that names this process's terminal; empty without a terminal."""
    try:
        return {_VARIABLE: os.ttyname(0)}
    except OSError:
        return {}


def install() -> None:
    """Have ``breakpoint()`` debug on the terminal, unless ``PYTHONBREAKPOINT`` or another debugger has taken it."""
    if "PYTHONBREAKPOINT" not in os.environ and sys.breakpointhook is sys.__breakpointhook__:
        sys.breakpointhook = _hold


def _hold(*arguments: Any, **keywords: Any) -> None:
    """Debug the caller on the terminal; without one, say so and go on."""
    del arguments, keywords
    name = os.environ.get(_VARIABLE) or terminal_variable().get(_VARIABLE, "")
    try:
        descriptor = os.open(name, os.O_RDWR | os.O_NOCTTY)
    except OSError:
        sys.stderr.write("mdms: breakpoint() is ignored: there is no terminal\n")
        return
    import pdb  # noqa: T100 - a debugger is asked for

    debugger = pdb.Pdb(stdin=os.fdopen(descriptor, "r"), stdout=os.fdopen(os.dup(descriptor), "w"))
    debugger.set_trace(sys._getframe(1))  # noqa: SLF001 # pyright: ignore[reportPrivateUsage]
