"""Runs in step with the wall clock, and what is said when they can't be."""

from __future__ import annotations

from pathlib import Path

import pytest

from deploy.control.pace import Pace
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import RunOptions


class Clock:
    """A wall clock that only sleeping and working move."""

    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, span_s: float) -> None:
        self.now_s += span_s


def _reported(work_s: list[float], factor: float = 2.0, first_s: float = 3.0) -> tuple[list[str], float]:
    """Lines of a run whose ticks of 1 s take so long each, and the wall time when it is over."""
    clock, lines = Clock(), list[str]()
    pace = Pace(factor, lines.append, clock=clock, sleep=clock.sleep)
    for number, span_s in enumerate(work_s):
        pace(int((first_s + number) * 1e9))
        clock.now_s += span_s
    return lines, clock.now_s - 100.0


def test_ticks_wait_for_their_time_counted_from_the_first_and_make_up_for_a_late_one() -> None:
    lines, wall_s = _reported([0.1, 0.1, 0.1])
    assert (lines, wall_s) == ([], pytest.approx(1.1))
    assert _reported([0.9, 0.1, 0.1, 0.1])[1] == pytest.approx(1.6)


def test_a_run_that_falls_behind_says_so_with_its_lag_whenever_that_has_doubled() -> None:
    lines, _ = _reported([1.0] * 10)
    assert lines == [
        "--realtime 2: can't keep up: 0.5 s behind the clock at 4.000 s (1 × real time so far)",
        "--realtime 2: can't keep up: 1.0 s behind the clock at 5.000 s (1 × real time so far)",
        "--realtime 2: can't keep up: 2.0 s behind the clock at 7.000 s (1 × real time so far)",
        "--realtime 2: can't keep up: 4.0 s behind the clock at 11.000 s (1 × real time so far)",
    ]


def test_a_run_that_has_caught_up_says_so_once() -> None:
    lines, _ = _reported([1.2, 0.1, 0.1, 0.1, 0.1])
    assert [line.partition(": ")[2].partition(" at ")[0] for line in lines] == [
        "can't keep up: 0.7 s behind the clock",
        "in step with the clock again",
    ]


def test_a_run_reports_its_lag_while_it_continues(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("deploy.control.pace._LAG_S", 1e-3)
    scene = load_scene("motors", [Override.parse("duration_s=0.2")])
    run(scene, RunOptions(0, "memory", output=tmp_path, picture=False, realtime=1e6))
    assert "mdms: --realtime 1e+06: can't keep up: 0.0 s behind the clock at " in capsys.readouterr().err
