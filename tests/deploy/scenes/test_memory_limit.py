"""What can't fit in memory is refused before it is allocated."""

from __future__ import annotations

import time
from pathlib import Path

import pytest

from deploy.cli import main
from deploy.errors import InputError
from deploy.runs.field_simulation import simulate
from deploy.scenes import memory_limit as room
from deploy.scenes.errors import SceneError
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions, plan

HUGE = [Override.parse("array.rows=10000"), Override.parse("array.columns=10000")]


@pytest.fixture(autouse=True)
def small_machine(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine with 20 GB left, whatever this one has."""
    monkeypatch.setattr(room, "available_bytes", lambda: 20 * 10**9)


@pytest.mark.parametrize("scene", ["elliptic", "heat", "junction"])
def test_an_array_that_can_t_fit_is_refused_by_the_scene_at_once(scene: str) -> None:
    begun = time.monotonic()
    with pytest.raises(SceneError) as refused:
        load_scene(scene, HUGE)
    assert time.monotonic() - begun < 5.0
    (line,) = str(refused.value).splitlines()
    assert line.startswith(
        f"scene {scene}: array.rows = 10000: 100,000,000 cells need about 120 GB of memory at least, and 20 GB are "
        "available: the array must be smaller"
    )


def test_the_command_ends_with_one_line_and_exit_status_2(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "elliptic", "--set", "array.rows=10000", "--set", "array.columns=10000"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert "array.rows = 10000: 100,000,000 cells need" in line


def test_parcels_and_processes_and_trajectories_that_can_t_fit_are_refused(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with pytest.raises(
        InputError, match=r"--processes each: 10,000 worker processes need about .* GB of memory"
    ):
        plan(load_scene("large"), RunOptions(processes="each"), "run")
    long = load_scene("elliptic", [Override.parse("duration_s=1e8")])
    with pytest.raises(
        InputError, match=r"duration_s = 1e\+08: a simulation keeps its whole trajectory, and 24,414,062,500"
    ):
        simulate(long, output=tmp_path, quiet=True)
    monkeypatch.setattr(room, "available_bytes", lambda: 1_000_000)
    with pytest.raises(SceneError, match=r"effects\.feeders.*: 5,000 parcels need about 5 MB"):
        load_scene("stream", [Override.parse("effects.feeders.feed.0.count=5000")])


def test_where_nothing_is_known_of_the_memory_nothing_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(room, "available_bytes", lambda: None)
    assert room.too_many_cells(10**12) == ""


def test_what_is_available_is_the_least_of_machine_and_control_group(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.undo()
    (tmp_path / "meminfo").write_text("MemTotal:  9000 kB\nMemAvailable:   8000 kB\n")
    monkeypatch.setattr(room, "_MEMINFO", tmp_path / "meminfo")
    monkeypatch.setattr(room, "_CGROUP", tmp_path)
    assert room.available_bytes() == 8_192_000
    (tmp_path / "memory.max").write_text("5000000\n")
    (tmp_path / "memory.current").write_text("2000000\n")
    assert room.available_bytes() == 3_000_000
    (tmp_path / "memory.max").write_text("max\n")
    assert room.available_bytes() == 8_192_000
    monkeypatch.setattr(room, "_MEMINFO", tmp_path / "none")
    assert room.available_bytes() is None


def test_paths_of_an_effects_study_that_can_t_fit_are_refused_at_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["effects", "elliptic", "--duration", "1e7", "--only", "pwm", "--quiet"]) == 2
    assert capsys.readouterr().err == (
        "scene elliptic: duration_s = 1e+07: the paths of 2 runs need about 234 GB of memory at least, and 20 GB are "
        "available: compare fewer effects, or a shorter duration_s\n"
    )
