"""Start of a run for the page, as a process that ends with it."""

from __future__ import annotations

import ctypes
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Final, final

from deploy.control.client import FILE_NAME, Address, discover
from deploy.errors import DeployError, InputError
from deploy.util.own_python import module_command

_READY_S: Final = 300.0
"""Longest wait for a run to begin, wall seconds: the first run of a scene compiles kernels."""
_END_S: Final = 10.0
"""Longest wait for a run to end after a signal, wall seconds."""
_LIBC: ctypes.CDLL | None = ctypes.CDLL(None) if sys.platform == "linux" else None
_PR_SET_PDEATHSIG: Final = 1
"""Of the Linux kernel's ``prctl``."""


@final
class LaunchedRun:
    """An ``mdms run`` as a process of its own; Ctrl-C in the terminal reaches it through this process alone.

    Args:
        arguments: Arguments of ``mdms run``.
        folder: Output folder of the run.
    """

    def __init__(self, arguments: Sequence[str], folder: Path) -> None:
        self.folder = folder
        self._process = subprocess.Popen(
            module_command("deploy.cli", "run", *arguments, "--output", str(folder)),
            stdin=subprocess.DEVNULL,
            start_new_session=True,
            preexec_fn=_end_with_parent,  # noqa: PLW1509 - there is no other thread yet
        )

    def address(self) -> Address:
        """Wait until the run can be spoken to, and return its address; after a reset that of the new run.

        Raises:
            InputError: The run refused its arguments; it has said why.
            DeployError: The run ended or did not begin in time.
        """
        deadline = time.monotonic() + _READY_S
        while time.monotonic() < deadline:
            for folder in (self.folder, *self._beside()):
                try:
                    return discover(folder)
                except InputError:
                    continue
            status = self._process.poll()
            if status is not None:
                if status == InputError.exit_code:
                    raise InputError("mdms view: the run did not begin")
                raise DeployError(f"mdms view: the run ended with status {status} before it could be shown")
            time.sleep(0.05)
        raise DeployError(f"mdms view: the run did not begin within {_READY_S:g} s")

    def _beside(self) -> list[Path]:
        """Return the other folders in which this process runs, as after a reset."""
        found: list[Path] = []
        for note in self.folder.parent.glob(f"*/{FILE_NAME}"):
            try:
                pid = json.loads(note.read_bytes())["pid"]
            except (OSError, ValueError, LookupError, TypeError):
                continue
            if pid == self._process.pid:
                found.append(note.parent)
        return found

    def end(self) -> None:
        """End the run as Ctrl-C does, which completes its recording; kill it if it doesn't end."""
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGKILL):
            if self._process.poll() is not None:
                return
            self._process.send_signal(number)
            try:
                self._process.wait(_END_S)
            except subprocess.TimeoutExpired:
                continue


def _end_with_parent() -> None:
    """Have the system end the run when this process is killed; runs in the new process before its program."""
    if _LIBC is not None:
        _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGTERM)
        if os.getppid() == 1:
            os.kill(os.getpid(), signal.SIGTERM)
