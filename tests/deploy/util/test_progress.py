"""The progress of a run, on a terminal and in a log."""

from __future__ import annotations

import io
import sys
import time

import pytest

from deploy.util.progress import Progress


class Clock:
    """Wall time that passes when the test says so."""

    def __init__(self) -> None:
        self.now = 100.0

    def __call__(self) -> float:
        return self.now


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr("deploy.util.progress.time.monotonic", clock)
    return clock


class Terminal(io.StringIO):
    """Something that says it is a terminal."""

    def isatty(self) -> bool:
        return True


def test_a_log_gets_a_line_now_and_then(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    with Progress(40_000_000_000) as progress:
        progress.update(1, 4_096_000)
        clock.now += 9.9
        progress.update(2, 8_192_000)
        assert capsys.readouterr().err == ""
        progress.events, progress.lost = 1234, 2
        clock.now += 0.1
        progress.update(5001, 20_000_000_000)
        assert capsys.readouterr().err == "mdms: 20.00 of 40 s  500 ticks/s  1,234 events  2 cells lost\n"


def test_a_terminal_gets_a_bar_a_few_times_a_second(clock: Clock, monkeypatch: pytest.MonkeyPatch) -> None:
    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    with Progress(10_000_000_000) as progress:
        for tick in range(100):
            clock.now += 0.005
            progress.update(tick, tick * 100_000_000)
        progress.say("cell 3,4 lost")
    shown = terminal.getvalue()
    assert "of 10 s" in shown
    assert "200 ticks/s" in shown
    assert "mdms: cell 3,4 lost" in shown
    assert shown.count("ticks/s") <= 5


def test_quiet_shows_nothing(clock: Clock, capsys: pytest.CaptureFixture[str]) -> None:
    with Progress(10_000_000_000, quiet=True) as progress:
        progress.update(1, 1)
        clock.now += 100.0
        progress.update(2, 2)
        progress.say("nothing")
    assert capsys.readouterr().err == ""


def test_an_update_costs_next_to_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stderr", Terminal())
    with Progress(10_000_000_000) as progress:
        progress.update(0, 0)
        begun = time.thread_time()
        for tick in range(10_000):
            progress.update(tick, tick)
        assert (time.thread_time() - begun) / 10_000 < 20e-6
