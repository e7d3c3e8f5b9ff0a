"""A run of ``heat`` in a process of its own, of any size, for benchmarks that look at it from outside."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from deploy.errors import DeployError, InputError
from deploy.live.client import LiveRun


def rate_of(run: LiveRun, seconds: float) -> float:
    """Return the ticks a second of the run."""
    before, begun = run.status()["tick"], time.perf_counter()
    time.sleep(seconds)
    after = run.status()["tick"]
    return (after - before) / (time.perf_counter() - begun)


@contextmanager
def running(cells: int) -> Iterator[tuple[LiveRun, int]]:
    """Run the scene inside the context, which gets the run and the id of its process."""
    side = round(cells**0.5)
    with tempfile.TemporaryDirectory() as folder:
        command = [
            sys.executable, "-c", "from deploy.cli import main; main()", "run", "heat", "--duration", "1e6", "-q",
            "--no-picture", "--output", folder, "--set", f"array.rows={side}", "--set", f"array.columns={side}",
            "--set", f"cells.parameters.held=[{{ columns = [0, {side - 1}], speed_m_s = [0.3, 0.0] }}]",
        ]  # fmt: skip
        with (Path(folder) / "stderr").open(
            "w+b"
        ) as stderr:  # which says "interrupted" at the end, as is meant
            process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=stderr)
            try:
                with attached(Path(folder), process) as run:
                    yield run, process.pid
            finally:
                ended = process.poll() is not None
                process.terminate()
                process.wait()
                if ended:
                    sys.stderr.write(Path(stderr.name).read_text(encoding="utf-8"))


def attached(folder: Path, process: subprocess.Popen[bytes]) -> LiveRun:
    """Attach as soon as the run answers."""
    while process.poll() is None:
        with suppress(InputError, DeployError):
            return LiveRun.attach(folder)
        time.sleep(0.1)
    raise SystemExit("the run has ended")
