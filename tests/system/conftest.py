"""Whole systems: started, interrupted, killed and looked at from outside."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.system.running import Mdms, is_alive
from tests.system.small import small_scene


@pytest.fixture(scope="session", autouse=True)
def kernels() -> None:
    """Compiled before anything is timed or interrupted."""
    from deploy.scenes.files import load_scene
    from plant.plant import Plant

    plant = Plant(load_scene("motors").plant_spec())
    plant.advance(plant.wheel_speed, 4_096_000)


@pytest.fixture
def small(tmp_path: Path) -> Callable[..., Path]:
    """Writes the small scene, with more at its end, and returns the file."""

    def write(more: str = "") -> Path:
        path = tmp_path / "small.toml"
        path.write_text(small_scene() + more)
        return path

    return write


@pytest.fixture
def mdms(tmp_path: Path) -> Iterator[Callable[..., Mdms]]:
    """Starts ``mdms`` with these arguments, its output in a folder of the test."""
    started: list[Mdms] = []

    def start(*arguments: object, output: Path | None = None) -> Mdms:
        folder = output or tmp_path / "out"
        command = [sys.executable, "-m", "deploy.cli", *map(str, arguments)]
        if arguments[0] in ("run", "simulate"):
            command += ["--output", str(folder)]
        running = Mdms.started(command, folder)
        started.append(running)
        return running

    yield start
    for running in started:
        with running.process as process:
            if process.poll() is None:
                process.kill()
        for pid in running.seen:
            if is_alive(pid):
                os.kill(pid, signal.SIGKILL)
