"""Cells that go away: scheduled, killed, stopped, or failing by themselves."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.runs.summary import Outcome
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.workers.plan import Processes, RunOptions
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


def _faulty(
    when: str, policy: str, small: Small, folder: Path, processes: Processes, on_failure: str = "isolate"
) -> Outcome:
    (folder / "faulty.py").write_text(FIRMWARE.replace("{when}", when))
    overrides = [
        Override(("cells",), {"firmware": str(folder / "faulty.py"), "on_failure": on_failure}, ""),
        Override(("stall",), {"policy": policy}, ""),
    ]
    scene = load_scene(str(small()), overrides)
    return run(scene, RunOptions(processes, output=folder / "out", picture=False), quiet=True)


@pytest.mark.parametrize(
    ("when", "words"), [("raise", "ZeroDivisionError: on purpose"), ("nan", "not finite")]
)
def test_isolated_a_cell_whose_program_fails_counts_as_crashed_and_the_run_goes_on(
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


def test_a_program_that_fails_ends_the_run_before_its_tick_alike_however_the_scene_is_cut(
    small: Small, tmp_path: Path
) -> None:
    ways: tuple[Processes, ...] = (0, 2, "each")
    outcomes = [_faulty("raise", "hold", small, tmp_path, processes, "stop") for processes in ways]
    for outcome in outcomes:
        summary = outcome.summary
        assert (summary.status, summary.ticks) == ("failed", 7)
        assert summary.reason == (
            "the program of cell 1,1 failed in tick 7 (0.028672 s): ZeroDivisionError: on purpose"
        )
        assert "Traceback" in outcome.detail
    assert len({outcome.summary.digest for outcome in outcomes}) == 1
    assert outcomes[0].summary.digest != _faulty("raise", "hold", small, tmp_path, 0).summary.digest
    assert load(tmp_path / "out").status == "ok"


def test_the_lowest_cell_is_named_however_the_scene_is_cut(small: Small, tmp_path: Path) -> None:
    program = FIRMWARE.replace("{when}", "raise").replace("place == (1, 1)", "place[1] > 0")
    (tmp_path / "several.py").write_text(program)
    cells = {"firmware": str(tmp_path / "several.py")}
    scene = load_scene(str(small()), [Override(("cells",), cells, "")])
    ways: tuple[Processes, ...] = (0, 3, "each")
    for processes in ways:
        options = RunOptions(processes, output=tmp_path / "out", picture=False)
        reason = run(scene, options, quiet=True).summary.reason or ""
        assert reason.startswith("the program of cell 0,1 failed in tick 7 (0.028672 s): "), processes
        assert reason.endswith("on purpose; 8 cells more failed in that tick"), processes


def test_a_run_at_whose_end_no_cell_is_left_failed(small: Small, tmp_path: Path) -> None:
    program = FIRMWARE.replace("{when}", "raise").replace("place == (1, 1) and ", "")
    (tmp_path / "all.py").write_text(program)
    cells = {"firmware": str(tmp_path / "all.py"), "on_failure": "isolate"}
    scene = load_scene(str(small()), [Override(("cells",), cells, "")])
    outcome = run(scene, RunOptions(0, output=tmp_path / "out", picture=False), quiet=True)
    assert (outcome.summary.status, outcome.summary.ticks) == ("failed", 49)
    assert outcome.summary.reason == (
        "no cell was alive at the end: cells 0,0 0,1 0,2 0,3 1,0 1,1 and 6 more lost in tick 7 (0.028672 s): "
        "ZeroDivisionError: on purpose"
    )
    assert "Traceback" in outcome.detail


def test_a_run_whose_scene_kills_all_cells_is_ok(small: Small, tmp_path: Path) -> None:
    crash = '[[faults]]\nkind = "crash"\nat_s = 0.05\nshare = 1.0\n'
    scene = load_scene(str(small(crash)))
    summary = run(scene, RunOptions(0, output=tmp_path / "out", picture=False), quiet=True).summary
    assert (summary.status, len(summary.cells_lost)) == ("ok", 12)


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


@pytest.mark.slow
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
    ("how", "kind"),
    [
        pytest.param(signal.SIGKILL, "disconnected", id="killed"),
        pytest.param(signal.SIGSTOP, "timed_out", id="stopped", marks=pytest.mark.slow),
    ],
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


@pytest.mark.slow
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


def test_a_program_that_never_returns_is_named_and_ends_a_run_in_one_process(
    mdms: Start, small: Small, tmp_path: Path
) -> None:
    (tmp_path / "faulty.py").write_text(FIRMWARE.replace("{when}", "hang"))
    running = mdms(
        "run", small(), "--processes", "0", "--json", "--no-picture", "--set", "stall.deadline_s=0.5",
        "--set", f'cells.firmware="{tmp_path / "faulty.py"}"', "--set", "cells.parameters={}",
    )  # fmt: skip
    status, stdout, stderr = running.end()
    summary = summary_of(stdout)
    assert (status, summary["status"], summary["ticks"], summary["cells_lost"]) == (1, "failed", 7, [[1, 1]])
    assert stderr.splitlines()[-1] == (
        "mdms: failed: the program of cell 1,1 failed in tick 7 (0.028672 s): NeverReturned: the step had not returned "
        "after 0.5 s (stall.deadline_s)"
    )
    assert 'in step\n    while "hang" == "hang":' in stderr


@pytest.mark.parametrize("transport", ["memory", "zenoh"])
def test_a_scene_in_which_all_cells_die_in_tick_0_runs_in_one_process_too(
    transport: str, tmp_path: Path
) -> None:
    crash = [
        Override(("faults",), [{"kind": "crash", "share": 1.0}], ""),
        Override(("duration_s",), 0.05, ""),
    ]
    options = RunOptions(0, transport, output=tmp_path, picture=False)  # type: ignore[arg-type]
    summary = run(load_scene("noisy", crash), options, quiet=True).summary
    assert (summary.status, summary.ticks) == ("ok", 13)
