"""Whole systems: started, interrupted, killed and looked at from outside."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]

SMALL = """
title = "Twelve cells that talk, a parcel between them"
duration_s = 0.2

[array]
rows = 3
columns = 4

[cells]
firmware = "heat_diffusion"
[cells.parameters]
diffusion_number = 0.2
held = [{ cell = [1, 0], speed_m_s = [0.1, 0.0] }]

[[parcels]]
size_m = [0.25, 0.15]
mass_kg = 1.0
position_m = [0.0, 0.0]

[friction]
law = "viscous"
coefficient_s_per_m = 0.2
"""
"""A scene that is over in no time and uses everything: links, borders, a moving parcel."""


@pytest.fixture(scope="session", autouse=True)
def kernels() -> None:
    """Compiled before anything is timed or interrupted."""
    from deploy.scene_files import load_scene
    from plant.plant import Plant

    plant = Plant(load_scene("prototype").plant_spec())
    plant.advance(plant.wheel_speed, 4_096_000)


@pytest.fixture
def small(tmp_path: Path) -> Callable[..., Path]:
    """Writes the small scene, with more at its end, and returns the file."""

    def write(more: str = "") -> Path:
        path = tmp_path / "small.toml"
        path.write_text(SMALL + more)
        return path

    return write


@dataclass
class Mdms:
    """A running ``mdms`` and what can be said of its processes."""

    process: subprocess.Popen[str]
    output: Path
    seen: set[int] = field(default_factory=set)

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
        return next(pid for pid in self.children() if _comm(pid) == name)

    def end(self, timeout_s: float = 20.0) -> tuple[int, str, str]:
        """Wait for its end; returns exit status, stdout and stderr, having seen that nothing is left."""
        self.children()
        stdout, stderr = self.process.communicate(timeout=timeout_s)
        self.assert_nothing_left()
        return self.process.returncode, stdout, stderr

    def assert_nothing_left(self, within_s: float = 3.0) -> None:
        """Everything that was ever seen of it has ended."""
        deadline = time.monotonic() + within_s
        while left := {pid for pid in self.seen if _alive(pid)}:
            assert time.monotonic() < deadline, f"still running: {[(pid, _comm(pid)) for pid in left]}"
            time.sleep(0.01)


@pytest.fixture
def mdms(tmp_path: Path) -> Iterator[Callable[..., Mdms]]:
    """Starts ``mdms`` with these arguments, its output in a folder of the test."""
    started: list[Mdms] = []

    def start(*arguments: object, output: Path | None = None) -> Mdms:
        folder = output or tmp_path / "out"
        command = [sys.executable, "-m", "deploy.cli", *map(str, arguments)]
        if arguments[0] in ("run", "simulate"):
            command += ["--output", str(folder)]
        process = subprocess.Popen(
            command,
            cwd=ROOT,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        running = Mdms(process, folder)
        started.append(running)
        return running

    yield start
    for running in started:
        with running.process as process:
            if process.poll() is None:
                process.kill()
        for pid in running.seen:
            if _alive(pid):
                os.kill(pid, signal.SIGKILL)


def summary_of(stdout: str) -> dict[str, Any]:
    """The one JSON object on stdout."""
    return json.loads(stdout)


def _descendants(pid: int) -> set[int]:
    found: set[int] = set()
    for task in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            children = {int(child) for child in task.read_text().split()}
        except OSError:
            continue
        for child in children:
            found |= {child} | _descendants(child)
    return found


def _comm(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/comm").read_text().strip()
    except OSError:
        return ""


def _alive(pid: int) -> bool:
    """Whether a process runs; a zombie does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
