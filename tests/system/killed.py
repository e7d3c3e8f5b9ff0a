"""Runs whose plant is killed and that are taken up again, until they are over."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deploy.checkpoints.store import FILE_NAME, Store
from deploy.errors import InputError
from tests.system.running import Mdms

MAIN = "from deploy.cli import main; main()"
_PATIENCE_S = 120.0


def start(output: Path, arguments: Sequence[str]) -> Mdms:
    """A run in a process of its own."""
    process = subprocess.Popen(
        [sys.executable, "-c", MAIN, "run", *arguments, "--no-picture", "--json", "--quiet"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    return Mdms(process, output)


def kill_after(mdms: Mdms, tick: int, delay_s: float) -> int | None:
    """Kill a run's plant so long after it has a checkpoint before a later tick than that.

    Returns:
        The tick of its last checkpoint; None where the run was over before.
    """
    deadline = time.monotonic() + _PATIENCE_S
    while (reached(mdms.output) or 0) <= tick:
        if mdms.process.poll() is not None:
            return None
        assert time.monotonic() < deadline, "no checkpoint came"
        time.sleep(0.005)
    time.sleep(delay_s)
    mdms.children()
    mdms.process.send_signal(signal.SIGKILL)
    mdms.process.communicate()
    return reached(mdms.output) if mdms.process.returncode == -signal.SIGKILL else None


def reached(output: Path) -> int | None:
    """Before which tick the last checkpoint in a folder is."""
    if not (output / FILE_NAME).exists():
        return None
    try:
        return Store(output).read().tick
    except InputError:
        return None


def ended(mdms: Mdms) -> dict[str, Any]:
    """The summary of a run that ends by itself."""
    out, error = mdms.process.communicate(timeout=_PATIENCE_S)
    assert mdms.process.returncode == 0, error
    return json.loads(out)
