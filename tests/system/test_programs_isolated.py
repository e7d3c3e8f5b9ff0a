"""Programs that fail in a campaign, in a run that is repeated, and in a run that is taken up again."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deploy.checkpoints.store import CheckpointStore, find_checkpoint, options_of, scene_of
from deploy.cli import main
from deploy.runs.run import run
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import Processes, RunOptions
from tests.system.small import small_scene

pytestmark = pytest.mark.slow

PROGRAM = """
from cell_firmware.cell import CellFirmware, CellOutputs
from cell_firmware.specs import Spec

class Failing(CellFirmware):
    class Parameters(Spec):
        at: int = 0

    def init(self, cell):
        if self.parameters.at < 0 and (cell.row, cell.column) == (1, 1):
            raise ZeroDivisionError("odd")
        return {"place": (cell.row, cell.column), "tick": 0}

    def step(self, state, inputs):
        tick, column = state["tick"], state["place"][1]
        if self.parameters.at > 0 and column in (1, 2) and tick == self.parameters.at * column:
            raise ZeroDivisionError("odd")
        return {**state, "tick": tick + 1}, CellOutputs((0.01 * column, 0.01 * (tick % 7)))
"""
RAISED = "ZeroDivisionError: odd"
FAILED = {(row, column) for row in range(3) for column in (1, 2)}


def _program(folder: Path) -> Path:
    path = folder / "failing.py"
    path.write_text(PROGRAM)
    return path


def _isolated(folder: Path, at: int) -> Scene:
    path = folder / "small.toml"
    path.write_text(small_scene())
    cells = {"firmware": str(_program(folder)), "on_failure": "isolate", "parameters": {"at": at}}
    return load_scene(str(path), [Override(("cells",), cells, "")])


@pytest.mark.parametrize(
    ("at", "reason"),
    [
        (
            5,
            f"the program of cell 0,1 failed in tick 5 (0.02048 s): {RAISED}; 2 cells more failed in that tick",
        ),
        (-1, f"cells: firmware of cell 1,1 failed in tick 0: init: {RAISED}"),
    ],
)
def test_runs_of_a_campaign_whose_programs_fail_are_counted_as_failed_with_their_cause_in_a_line(
    at: int, reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, folder = tmp_path / "small.toml", tmp_path / "out"
    scene.write_text(small_scene())
    program = f'cells={{ firmware = "{_program(tmp_path)}" }}'
    asked = [
        "--vary",
        f"cells.parameters.at=0,{at}",
        "--seeds",
        "2",
        "--set",
        "goal={ place_m = [0, 0], within_m = 9 }",
    ]
    arguments = ["campaign", str(scene), "--set", program, *asked, "--jobs", "1", "--output", str(folder)]
    assert main([*arguments, "--json", "--quiet"]) == 0, "some runs came to their end"
    report = json.loads(capsys.readouterr().out)
    assert report["status"] == "ok"
    good, bad = report["rows"]
    assert (good["runs"], good["failed"]) == (2, 0)
    assert (bad["runs"], bad["failed"], bad["succeeded"]) == (2, 2, 0)
    values = {"cells.parameters.at": at}
    assert report["failed"] == [
        {"values": values, "seed": seed, "status": "failed", "reason": reason} for seed in (0, 1)
    ]


def test_a_campaign_all_of_whose_programs_fail_has_failed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene, folder = tmp_path / "small.toml", tmp_path / "out"
    scene.write_text(small_scene())
    program = f'cells={{ firmware = "{_program(tmp_path)}", parameters = {{ at = 5 }} }}'
    asked = [
        "--vary",
        "duration_s=0.1,0.2",
        "--seeds",
        "1",
        "--set",
        "goal={ place_m = [0, 0], within_m = 9 }",
    ]
    arguments = ["campaign", str(scene), "--set", program, *asked, "--jobs", "1", "--output", str(folder)]
    assert main([*arguments, "--quiet"]) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert "no run completed; the first: failed: the program of cell 0,1 failed in tick 5" in last


@pytest.mark.parametrize("processes", [0, 2, "each"])
def test_a_run_with_isolated_failures_is_repeated_to_the_digest(processes: Processes, tmp_path: Path) -> None:
    scene, first = _isolated(tmp_path, at=9), tmp_path / "first"
    before = run(scene, RunOptions(processes, output=first, picture=False), quiet=True).summary
    assert (before.status, set(before.cells_lost)) == ("ok", FAILED)
    options = RunOptions(0, "memory", output=tmp_path / "again", picture=False, replay=first)
    again = run(scene, options, quiet=True).summary
    assert (again.status, again.reason, again.digest) == ("ok", before.reason, before.digest)
    assert again.cells_lost == before.cells_lost
    assert [fault["tick"] for fault in again.faults] == [9] * 3 + [18] * 3


@pytest.mark.parametrize("processes", [0, 2])
@pytest.mark.parametrize("at", [5, 24], ids=["before the checkpoint", "on both sides of it"])
def test_a_run_with_isolated_failures_is_taken_up_again_to_the_digest(
    at: int, processes: Processes, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene, folder = _isolated(tmp_path, at), tmp_path / "out"
    whole = run(scene, RunOptions(processes, output=tmp_path / "whole", picture=False), quiet=True).summary
    with monkeypatch.context() as patched:
        patched.setattr(CheckpointStore, "clear", lambda _: None)
        options = RunOptions(processes, output=folder, picture=False, checkpoint_s=1e-3, realtime=0.3)
        assert run(scene, options, quiet=True).summary.digest == whole.digest
    (folder / "summary.json").unlink()
    checkpoint = find_checkpoint(folder)
    assert at < checkpoint.tick < whole.ticks
    assert (len(checkpoint.dead) == len(FAILED)) == (at == 5)
    options = options_of(checkpoint, RunOptions(output=folder, picture=False))
    resumed = run(scene_of(checkpoint), options, quiet=True, resumed=checkpoint).summary
    assert (resumed.status, resumed.digest) == ("ok", whole.digest)
    assert resumed.cells_lost == whole.cells_lost
    assert set(resumed.cells_lost) == FAILED
    assert [fault["detail"] for fault in resumed.faults] == [fault["detail"] for fault in whole.faults]
