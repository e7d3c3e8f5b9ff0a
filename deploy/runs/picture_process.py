"""Process that draws the overview of a run: it imports the library of plots while the run goes on.

Importing that library takes as long as a short run. In a thread it would take the time from the run.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from types import FrameType, TracebackType
from typing import Final, Self, final

_DRAWER: Final = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from deploy.runs.picture_process import main; main()"
)
_AHEAD: Final = (
    "matplotlib.backends.backend_agg",
    "matplotlib.figure",
    "deploy.plots.legend",
    "deploy.plots.map_view",
    "deploy.recordings.checks",
    "deploy.recordings.mcap_reader",
)
"""Modules that drawing imports."""
_PATIENCE_S: Final = 1.0
"""Longest wait for the process to leave after SIGTERM."""


@final
class PictureProcess:
    """Process that draws the overview of one run, and ends with the context."""

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        with contextlib.suppress(OSError):  # then `draw` says so
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-c", _DRAWER, json.dumps(sys.path)],
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,  # Ctrl-C in the terminal is for the main process alone
            )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._process is None:
            return
        assert self._process.stdin is not None
        self._process.stdin.close()
        self._process.terminate()
        try:
            self._process.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def draw(self, folder: Path) -> bool:
        """Draw the recording in a folder, and wait until that is done; call once.

        Returns:
            Whether it was drawn. If not, the cause is found by drawing it in this process.
        """
        if self._process is None:
            return False
        assert self._process.stdin is not None
        with contextlib.suppress(OSError), self._process.stdin as order:  # it may have ended
            order.write(os.fsencode(folder))
        return self._process.wait() == 0


def main() -> None:
    """Draw the recording in the folder that is named on stdin; do nothing if no folder is named."""
    signal.signal(signal.SIGTERM, _leave)
    gc.disable()  # nearly all objects of imports stay
    for module in _AHEAD:
        importlib.import_module(module)
    from deploy.plots.overview import FILE_NAME, draw_overview
    from deploy.recordings.reader import load

    name = sys.stdin.buffer.read()
    if name:
        folder = Path(os.fsdecode(name))
        draw_overview(load(folder), folder / FILE_NAME)
    os._exit(0)  # the file is closed, and tidying up would take as long as drawing


def _leave(number: int, frame: FrameType | None) -> None:
    """End the process by an exception, so that a draft of the picture is removed."""
    del number, frame
    sys.exit(1)
