"""Cells that go away: scheduled, killed, stopped, or failing by themselves."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deploy.overrides import Override
from deploy.processes.plan import Processes, RunOptions
from deploy.recordings.replay import load
from deploy.run import run
from deploy.scene_files import load_scene
from deploy.summary import Outcome
from tests.system.running import Mdms, summary_of

Start = Callable[..., Mdms]
Small = Callable[..., Path]

FIRMWARE = """
import math
from cell_firmware.cell import CellFirmware, CellOutputs

class Faulty(CellFirmware):
    def init(self, cell):
        if "{when}" == "init" and (cell.row, cell.column) == (1, 1):
            raise ZeroDivisionError("in init")
        return (cell.row, cell.column), 0

    def step(self, state, inputs):
        place, tick = state
        speed = (0.1, 0.0)
        if place == (1, 1) and tick == 7:
            while "{when}" == "hang":
                pass
            if "{when}" == "raise":
                raise ZeroDivisionError("on purpose")
            if "{when}" == "nan":
                speed = (math.nan, 0.0)
        return (place, tick + 1), CellOutputs(speed)
"""

WAYS: list[Processes] = [0, 2]


def _faulty(when: str, policy: str, small: Small, folder: Path, processes: Processes) -> Outcome:
    (folder / "faulty.py").write_text(FIRMWARE.replace("{when}", when))
    overrides = [
        Override(("cells",), {"firmware": str(folder / "faulty.py")}, ""),
        Override(("stall",), {"policy": policy}, ""),
    ]
    scene = load_scene(str(small()), overrides)
    return run(scene, RunOptions(processes, output=folder / "out", picture=False), quiet=True)


@pytest.mark.parametrize(
    ("when", "words"), [("raise", "ZeroDivisionError: on purpose"), ("nan", "not finite")]
)
def test_a_cell_whose_firmware_fails_counts_as_crashed_and_the_run_goes_on(
    when: str, words: str, small: Small, tmp_path: Path
) -> None:
    summaries = [_faulty(when, "coast", small, tmp_path, processes).summary for processes in (0, 2, "each")]
    for summary in summaries:
        (fault,) = summary.faults
        assert summary.status == "ok"
        assert list(summary.cells_lost) == [(1, 1)]
        assert (fault["kind"], fault["cell"], fault["tick"]) == ("failed", [1, 1], 7)
        assert words in fault["detail"]
    assert len({summary.digest for summary in summaries}) == 1
    assert load(tmp_path / "out").faults[0]["detail"] == summaries[-1].faults[0]["detail"]


@pytest.mark.parametrize("processes", WAYS)
@pytest.mark.parametrize("when", ["raise", "nan"])
def test_under_abort_a_firmware_that_fails_ends_the_run_with_cell_tick_and_traceback(
    when: str, processes: Processes, small: Small, tmp_path: Path
) -> None:
    outcome = _faulty(when, "abort", small, tmp_path, processes)
    assert outcome.summary.status == "failed"
    assert outcome.summary.ticks == 7
    assert "cell 1,1 lost in tick 7" in (outcome.summary.reason or "")
    assert ("Traceback" in outcome.detail) == (when == "raise")
    assert load(tmp_path / "out").status == "failed"


@pytest.mark.parametrize("processes", WAYS)
def test_a_firmware_that_fails_before_the_first_tick_fails_the_run_at_once(
    processes: Processes, small: Small, tmp_path: Path
) -> None:
    outcome = _faulty("init", "coast", small, tmp_path, processes)
    assert outcome.summary.status == "failed"
    assert "1,1" in (outcome.summary.reason or "")
    assert "ZeroDivisionError: in init" in outcome.detail
    assert outcome.summary.ticks == 0


def test_a_crash_under_abort_ends_the_run_before_its_tick(small: Small, tmp_path: Path) -> None:
    crash = '[stall]\npolicy = "abort"\n[[faults]]\nkind = "crash"\nat_s = 0.05\ncell = [2, 3]\n'
    scene = load_scene(str(small(crash)))
    summary = run(scene, RunOptions(0, output=tmp_path / "out", picture=False), quiet=True).summary
    assert (summary.status, summary.ticks) == ("failed", 13)
    assert summary.reason == "cell 2,3 crashed at 0.053248 s as scheduled; stall.policy is abort"


def test_a_scheduled_crash_kills_the_process_of_its_cell_alone(mdms: Start, small: Small) -> None:
    scene = small('[[faults]]\nkind = "crash"\nat_s = 1.0\ncell = [2, 3]\n')
    running = mdms("run", scene, "--duration", 600, "--realtime", "--processes", "each")
    running.wait_until_recorded()
    before = running.children()
    victim = running.worker("cell 2,3")
    running.wait_for(lambda: victim not in running.children(), "the process of cell 2,3 had died")
    assert running.children() == before - {victim}
    running.wait_for(lambda: bool(load(running.output).faults), "the crash was recorded")
    running.process.send_signal(signal.SIGINT)
    running.end()
    (fault,) = load(running.output).faults
    assert (fault["kind"], fault["cell"], fault["tick"]) == ("crash", [2, 3], 245)


def _kill_a_worker(mdms: Start, policy: str, how: signal.Signals) -> tuple[int, dict[str, Any], str, Mdms]:
    running = mdms(
        "run", "motors", "--processes", "2", "--json", "--no-picture", "--realtime", "--duration", "2.5",
        "--set", f'stall.policy="{policy}"', "--set", "stall.deadline_s=0.3",
    )  # fmt: skip
    running.wait_until_recorded()
    os.kill(running.worker("cells 1"), how)
    status, stdout, stderr = running.end()
    return status, summary_of(stdout), stderr, running


LOST = [[r, c] for r, c in ((2, 1), (2, 2), (2, 3), (2, 4), (2, 5), (3, 1), (3, 2), (3, 3), (3, 4))]


@pytest.mark.parametrize(
    ("how", "kind"), [(signal.SIGKILL, "token_lost"), (signal.SIGSTOP, "stalled")], ids=["killed", "stopped"]
)
def test_a_run_goes_on_without_a_worker_that_is_killed_or_stopped(
    how: signal.Signals, kind: str, mdms: Start
) -> None:
    status, summary, stderr, running = _kill_a_worker(mdms, "brake", how)
    assert (status, summary["status"], summary["simulated_s"]) == (0, "ok", 2.5)
    assert [cell for cell in summary["cells_lost"] if cell not in LOST] == []
    assert len(summary["cells_lost"]) == len(LOST)
    assert {fault["kind"] for fault in summary["faults"]} == {kind}
    assert len({fault["tick"] for fault in summary["faults"]}) == 1
    assert "mdms: cells 2,1 2,2 2,3 2,4 2,5 3,1 and 3 more lost in tick" in stderr
    assert len(load(running.output).faults) == len(LOST)


@pytest.mark.parametrize(
    ("how", "outcome"), [(signal.SIGKILL, "failed"), (signal.SIGSTOP, "stalled")], ids=["killed", "stopped"]
)
def test_under_abort_a_lost_worker_ends_the_run_and_the_last_line_says_what_and_where(
    how: signal.Signals, outcome: str, mdms: Start
) -> None:
    status, summary, stderr, running = _kill_a_worker(mdms, "abort", how)
    assert (status, summary["status"]) == (1, outcome)
    assert stderr.splitlines()[-1].startswith(
        f"mdms: {outcome}: cells 2,1 2,2 2,3 2,4 2,5 3,1 and 3 more lost in"
    )
    assert load(running.output).status == outcome


def test_a_firmware_that_never_returns_does_not_keep_a_run_in_one_process_from_ending(
    mdms: Start, small: Small, tmp_path: Path
) -> None:
    (tmp_path / "faulty.py").write_text(FIRMWARE.replace("{when}", "hang"))
    running = mdms(
        "run", small(), "--processes", "0", "--json", "--no-picture", "--set", "stall.deadline_s=0.2",
        "--set", f'cells.firmware="{tmp_path / "faulty.py"}"', "--set", "cells.parameters={}",
    )  # fmt: skip
    status, stdout, _ = running.end()
    assert (status, len(summary_of(stdout)["cells_lost"])) == (0, 12)
