"""Ctrl-C, SIGTERM and kill -9 at any moment: nothing is left running, and what was recorded can be read."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from deploy.recordings.format import FILE_NAME
from deploy.recordings.reader import load
from tests.system.running import Mdms, summary_of

LONG = ("--duration", "600", "--realtime")
"""Ten minutes: such a run ends only because it is ended."""

Start = Callable[..., Mdms]


@pytest.mark.parametrize(
    ("number", "processes"),
    [(signal.SIGINT, "0"), (signal.SIGTERM, "2"), (signal.SIGINT, "each")],
    ids=["SIGINT to one process", "SIGTERM to two workers", "SIGINT to a process a cell"],
)
def test_a_signal_in_the_middle_of_a_run_ends_it_with_130_and_a_whole_recording(
    number: signal.Signals, processes: str, mdms: Start
) -> None:
    running = mdms("run", "motors", *LONG, "--processes", processes, "--json")
    running.wait_until_recorded()
    running.process.send_signal(number)
    status, stdout, stderr = running.end()
    summary = summary_of(stdout)
    recording = load(running.output)
    assert status == 130
    assert summary["status"] == recording.status == "interrupted"
    assert stderr.splitlines()[-1].startswith("mdms: interrupted at ")
    assert recording.tick[-1] == summary["ticks"] > 0
    assert recording.digest == summary["digest"]


@pytest.mark.parametrize("after_s", [0.1, 0.35, 0.6])
def test_a_signal_during_start_up_leaves_nothing_running(after_s: float, mdms: Start) -> None:
    running = mdms("run", "motors", *LONG, "--processes", "each")
    deadline = time.monotonic() + after_s
    while time.monotonic() < deadline:
        running.children()
        time.sleep(0.005)
    running.process.send_signal(signal.SIGINT)
    status, _, stderr = running.end()
    # Before the command's first line is reached Python ends by the signal itself.
    assert status == 130 or (status == -signal.SIGINT and "in main" not in stderr)


@pytest.mark.parametrize("workers", [0, 7], ids=["the parent", "several workers"])
def test_a_signal_while_processes_are_started_leaves_nothing_running(workers: int, mdms: Start) -> None:
    running = mdms("run", "motors", *LONG, "--processes", "each")
    running.wait_until_started(workers)
    running.process.send_signal(signal.SIGTERM)
    assert running.end()[0] == 130


@pytest.mark.slow
def test_a_signal_while_the_picture_is_drawn_keeps_recording_and_summary(mdms: Start) -> None:
    running = mdms("run", "motors", "--duration", "2", "--processes", "1", "--json")
    running.wait_for((running.output / "summary.json").exists, "the summary was written")
    running.process.send_signal(signal.SIGINT)
    status, stdout, _ = running.end()
    assert status == 130
    assert summary_of(stdout)["status"] == "interrupted"
    assert load(running.output).status == "ok"
    assert not (running.output / "overview.png").exists()
    assert sorted(path.name for path in running.output.iterdir()) == [FILE_NAME, "summary.json"]


@pytest.mark.slow
def test_a_second_signal_does_not_spoil_the_end(mdms: Start) -> None:
    running = mdms("run", "motors", *LONG, "--processes", "2", "--json")
    running.wait_until_recorded()
    for _ in range(5):
        running.process.send_signal(signal.SIGINT)
        time.sleep(0.01)
    status, stdout, _ = running.end()
    assert status == 130
    assert load(running.output).digest == summary_of(stdout)["digest"]


@pytest.mark.slow
def test_the_workers_end_with_a_main_process_that_is_killed(mdms: Start) -> None:
    running = mdms("run", "motors", *LONG, "--processes", "each")
    running.wait_until_recorded()
    started = running.children()
    assert len(started) == 19
    running.process.kill()
    running.process.wait()
    running.assert_nothing_left(within_s=1.0)


@pytest.mark.slow
def test_a_recording_after_kill_9_holds_all_but_the_last_half_second(mdms: Start) -> None:
    running = mdms("run", "motors", *LONG, "--processes", "1")
    running.wait_until_recorded()
    before, at = load(running.output).time_s[-1], time.monotonic()
    time.sleep(1.0)
    running.process.kill()
    simulated = before + time.monotonic() - at
    running.process.wait()
    recording = load(running.output)
    assert recording.status is None
    assert recording.time_s[-1] > simulated - 0.5


@pytest.mark.slow
def test_the_workers_end_though_their_parent_is_killed_first(mdms: Start) -> None:
    running = mdms("run", "motors", *LONG, "--processes", "2")
    running.wait_until_recorded()
    parent = min(running.children())
    os.kill(parent, signal.SIGKILL)
    running.process.send_signal(signal.SIGINT)
    assert running.end()[0] == 130


@pytest.mark.slow
def test_an_interrupted_run_leaves_no_temporary_files(
    mdms: Start, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = tmp_path / "temporary"
    temporary.mkdir()
    monkeypatch.setenv("TMPDIR", str(temporary))
    shared = set(Path("/dev/shm").iterdir())
    running = mdms("run", "motors", *LONG, "--processes", "2")
    running.wait_until_recorded()
    running.process.send_signal(signal.SIGINT)
    running.end()
    assert list(temporary.iterdir()) == []
    assert {
        path for path in set(Path("/dev/shm").iterdir()) - shared if path.name.startswith("sem.")
    } == set()


@pytest.mark.parametrize("after_s", [0.4, 0.8])
def test_a_signal_ends_a_simulation_with_130(after_s: float, mdms: Start) -> None:
    running = mdms("simulate", "elliptic", "--duration", "20000")
    time.sleep(after_s)
    running.process.send_signal(signal.SIGTERM)
    assert running.end()[0] in (130, -signal.SIGTERM)
