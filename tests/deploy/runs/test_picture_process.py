"""The overview of a run is drawn by a process of its own, and by the run itself where that fails."""

from __future__ import annotations

import subprocess
from pathlib import Path
from typing import Any

import pytest

from deploy.plots.overview import draw_overview
from deploy.recordings.reader import load
from deploy.runs.picture_process import PictureProcess
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions


def _recorded(folder: Path, *, workers: int = 0, **given: Any) -> None:
    scene = load_scene("elliptic", [Override(("duration_s",), 0.01, "--duration")])
    options = RunOptions(workers, "zenoh" if workers else "memory", output=folder, **given)
    assert run(scene, options, quiet=True).summary.status == "ok"


def test_it_draws_the_picture_that_this_process_draws(tmp_path: Path) -> None:
    _recorded(tmp_path, picture=False)
    with PictureProcess() as picture:
        assert picture.draw(tmp_path)
    draw_overview(load(tmp_path), tmp_path / "other.png")
    assert (tmp_path / "overview.png").read_bytes() == (tmp_path / "other.png").read_bytes()


def test_what_can_not_be_drawn_is_not_said_to_be(tmp_path: Path) -> None:
    with PictureProcess() as picture:
        assert not picture.draw(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_process_that_can_not_be_started_draws_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*arguments: object, **options: object) -> None:
        raise OSError(11, "Resource temporarily unavailable")

    monkeypatch.setattr(subprocess, "Popen", refused)
    with PictureProcess() as picture:
        assert not picture.draw(tmp_path)


def test_leaving_the_context_ends_it(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def start(command: list[str], **options: int) -> subprocess.Popen[bytes]:
        started.append(popen(command, **options))  # pyright: ignore[reportCallIssue, reportArgumentType]
        return started[-1]

    monkeypatch.setattr(subprocess, "Popen", start)
    with PictureProcess():
        assert started[0].poll() is None
    assert started[0].returncode is not None


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "expected"),
    [({}, "drawn by a process"), ({"picture": False}, "none"), ({"realtime": 100.0}, "drawn here")],
)
def test_a_process_draws_unless_it_could_delay_ticks(
    options: dict[str, Any], expected: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[PictureProcess] = []
    enter = PictureProcess.__enter__

    def noted(process: PictureProcess) -> PictureProcess:
        started.append(process)
        return enter(process)

    monkeypatch.setattr(PictureProcess, "__enter__", noted)
    _recorded(tmp_path, workers=1, **options)
    assert len(started) == (expected == "drawn by a process")
    assert (tmp_path / "overview.png").exists() is (expected != "none")


@pytest.mark.slow
def test_a_run_draws_itself_if_the_process_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("deploy.runs.picture_process._DRAWER", "raise SystemExit(1)")
    _recorded(tmp_path, workers=1)
    assert (tmp_path / "overview.png").read_bytes().startswith(b"\x89PNG")
