"""Commands of subprocesses: modules of this project."""

from __future__ import annotations

import json
import sys
from typing import Final

_MODULE: Final = (
    "import json, runpy, sys; sys.path[:] = json.loads(sys.argv[1]); del sys.argv[:2]; "
    "runpy.run_module(sys.argv[0], run_name='__main__', alter_sys=True)"
)


def module_command(name: str, *arguments: str) -> list[str]:
    """Return a command that runs a module in this Python, with the search path of this process.

    ``python -m`` would search the current folder first: a file ``json.py`` of the user's would take the place of
    Python's own.

    Args:
        name: The module.
        *arguments: Its arguments.
    """
    return [sys.executable, "-P", "-c", _MODULE, json.dumps(sys.path), name, *arguments]
