"""A running ``mdms``, seen from outside: its processes, its files, its end."""

from __future__ import annotations

import json
import subprocess
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]


@dataclass
class Mdms:
    """A running ``mdms`` and what can be said of its processes."""

    process: subprocess.Popen[str]
    output: Path
    seen: set[int] = field(default_factory=set)

    @staticmethod
    def started(command: Sequence[str], output: Path) -> Mdms:
        """Start it, with nothing to read on stdin and in a session of its own."""
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        return Mdms(process, output)

    def children(self) -> set[int]:
        """Process ids of everything it has started, directly or not."""
        found = _descendants(self.process.pid)
        self.seen |= found
        return found

    def wait_for(self, condition: Callable[[], bool], what: str, timeout_s: float = 30.0) -> None:
        """Wait until something is so; fails the test if it never is."""
        deadline = time.monotonic() + timeout_s
        while not condition():
            assert self.process.poll() is None, f"ended before {what}:\n{self.process.communicate()}"
            assert time.monotonic() < deadline, f"still not after {timeout_s} s: {what}"
            time.sleep(0.005)

    def wait_until_started(self, workers: int = 1) -> set[int]:
        """Wait for the parent of the workers and that many workers; returns all of them."""
        self.wait_for(lambda: len(self.children()) > workers, "all workers were there")
        return self.children()

    def wait_until_recorded(self, size: int = 4_000) -> None:
        """Wait until the recording has grown: the run is under way."""
        path = self.output / "recording.mcap"
        self.wait_for(lambda: path.exists() and path.stat().st_size > size, "the recording grew")
        self.children()

    def worker(self, name: str) -> int:
        """Process id of the worker that shows this name."""
        return next(pid for pid in self.children() if name_of(pid) == name)

    def end(self, timeout_s: float = 20.0) -> tuple[int, str, str]:
        """Wait for its end; returns exit status, stdout and stderr, having seen that nothing is left."""
        self.children()
        stdout, stderr = self.process.communicate(timeout=timeout_s)
        self.assert_nothing_left()
        return self.process.returncode, stdout, stderr

    def assert_nothing_left(self, within_s: float = 3.0) -> None:
        """Everything that was ever seen of it has ended."""
        deadline = time.monotonic() + within_s
        while left := {pid for pid in self.seen if is_alive(pid)}:
            assert time.monotonic() < deadline, f"still running: {[(pid, name_of(pid)) for pid in left]}"
            time.sleep(0.01)


def summary_of(stdout: str) -> dict[str, Any]:
    """The one JSON object on stdout."""
    return json.loads(stdout)


def _tasks(pid: int) -> list[Path]:
    try:
        return list(Path(f"/proc/{pid}/task").iterdir())
    except OSError:  # it has gone
        return []


def _descendants(pid: int) -> set[int]:
    found: set[int] = set()
    for task in _tasks(pid):
        try:
            children = {int(child) for child in (task / "children").read_text().split()}
        except OSError:
            continue
        for child in children:
            found |= {child} | _descendants(child)
    return found


def name_of(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text().strip()
    except OSError:
        return ""


def is_alive(pid: int) -> bool:
    """Whether a process runs; a zombie does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
