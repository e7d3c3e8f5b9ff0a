"""Runs whose plant is killed and that are taken up again."""

from __future__ import annotations

import signal
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from deploy.checkpoints.store import FILE_NAME, PREVIOUS, CheckpointStore
from deploy.errors import InputError
from deploy.recordings.reader import load
from tests.system.running import Mdms, summary_of

_PATIENCE_S = 120.0


class Kill(NamedTuple):
    """What a kill left.

    Attributes:
        tick: Before which tick the last checkpoint is.
        age_s: Wall time since that was written, at the kill.
    """

    tick: int
    age_s: float


def start(output: Path, *arguments: object) -> Mdms:
    """A run, or one that goes on, in a process of its own."""
    command = [
        sys.executable,
        "-m",
        "deploy.cli",
        "run",
        *map(str, arguments),
        "--no-picture",
        "--json",
        "--quiet",
    ]
    return Mdms.started(command, output)


def kill_after(mdms: Mdms, tick: int, delay_s: float) -> Kill | None:
    """Kill a run's plant so long after it has a checkpoint of a later tick than that, and see that nothing is left.

    Returns:
        What that left; None where the run was over before.
    """
    deadline = time.monotonic() + _PATIENCE_S
    while reached(mdms.output) <= tick:
        if mdms.process.poll() is not None:
            return None
        assert time.monotonic() < deadline, "no checkpoint came"
        time.sleep(0.01)
    time.sleep(delay_s)
    killed = time.time()
    if not kill(mdms):
        return None
    # it may have been killed between two renames
    written = max(
        path.stat().st_mtime for path in map(mdms.output.joinpath, (FILE_NAME, PREVIOUS)) if path.exists()
    )
    return Kill(reached(mdms.output), killed - written)


def kill(mdms: Mdms) -> bool:
    """Kill a run's plant, and see that nothing is left of it; False where the run was over before."""
    mdms.children()
    mdms.process.send_signal(signal.SIGKILL)
    mdms.process.communicate()
    mdms.assert_nothing_left()
    return mdms.process.returncode == -signal.SIGKILL


def refusal(output: Path) -> str:
    """The one line with which a run is refused to go on."""
    status, out, error = start(output, "--resume", output).end(_PATIENCE_S)
    assert (status, out, error.count("\n")) == (2, "", 1), error
    return error


def reached(output: Path) -> int:
    """Before which tick the last checkpoint in a folder is; 0 where there is none."""
    try:
        return CheckpointStore(output).read().tick
    except InputError:
        return 0


def ended(mdms: Mdms) -> dict[str, Any]:
    """The summary of a run that ends by itself, of which nothing is left."""
    status, out, error = mdms.end(_PATIENCE_S)
    assert status == 0, error
    return summary_of(out)


def assert_whole(output: Path, ticks: int, digest: str) -> None:
    """No tick is missing in the recording, or there twice, and it says how its run ended."""
    recording = load(output)
    assert np.array_equal(recording.tick, np.arange(ticks + 1))
    assert (recording.status, recording.digest) == ("ok", digest)
