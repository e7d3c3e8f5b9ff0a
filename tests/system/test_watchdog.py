"""Programs that hang in whole runs: reset, started anew, and told once."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.lockstep.participant import Participant
from deploy.recordings.reader import load
from deploy.runs.run import run
from deploy.scenes.errors import SceneError
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions
from tests.system.test_same_digest import EACH, WAYS, Way

FIELD = {"kind": "uniform", "velocity_m_s": [0.1, 0.05]}
STUMBLING: dict[str, Any] = {
    "firmware": "hanging_field",
    "parameters": {"field": FIELD, "cells": [[1, 1], [0, 3]], "after_periods": 10},
}
COP = {"cop": {"timeout_s": 0.016384, "reboot_s": 0.01}}


def _scene(path: Path, **effects: object) -> Scene:
    return load_scene(str(path), [Override(("cells",), STUMBLING, ""), Override(("effects",), effects, "")])


def _go(scene: Scene, way: Way, output: Path, *, quiet: bool = True) -> Any:
    processes, transport, wire = way
    options = RunOptions(processes, transport, wire, output=output, picture=False)
    return run(scene, options, quiet=quiet).summary


@pytest.mark.slow
def test_resets_act_alike_however_the_scene_is_cut_and_no_cell_is_lost(
    small: Callable[..., Path], tmp_path: Path
) -> None:
    scene = _scene(small(), **COP)
    summaries = {way: _go(scene, way, tmp_path) for way in (WAYS[0], WAYS[4], WAYS[7], *EACH)}
    assert len({one.digest for one in summaries.values()}) == 1, summaries
    for one in summaries.values():
        assert (one.status, list(one.cells_lost), list(one.faults)) == ("ok", [], [])
        assert one.effects == {"cop.hangs": 6, "cop.resets": 6}
    drives = load(tmp_path).drives
    stumbles = [5, 3]  # of three rows of four
    # hung in tick 10, last served in 9: reset at 65.536 ms, tick 16; up at 75.536 ms, tick 19; 49 ticks in all
    speed = np.zeros((49, 1))
    speed[[*range(16), *range(19, 32), *range(35, 48)]] = 1.0
    for cell in stumbles:
        assert np.array_equal(drives[:49, cell], speed * [0.1, 0.05])
    others = [i for i in range(12) if i not in stumbles]
    assert np.all(drives[:49, others] == [0.1, 0.05])


FALTERING = """
from cell_firmware.cell import CellFirmware, CellOutputs
import numpy as np

class Faltering(CellFirmware):
    message = np.dtype([("heat", "<f4")])

    def init(self, cell):
        return 0.05 * cell.column, 0, (cell.row + cell.column) % 3

    def step(self, state, inputs):
        heat, steps, kind = state
        if kind == 1 and steps == 9:
            raise RuntimeError("stuck")
        heard = [message["heat"] for message in inputs.inbox.values() if message is not None]
        heat += sum(0.1 * (other - heat) for other in heard)
        message = dict.fromkeys(inputs.inbox, {"heat": heat})
        return (heat, steps + 1, kind), CellOutputs((heat, 0.0), message, served=kind != 2 or steps < 5)
"""
"""Cells that hang, cells that stop serving, and cells that do neither, to which every message matters."""


@pytest.mark.slow
def test_resets_go_with_clocks_and_serial_lines_however_the_scene_is_cut(
    small: Callable[..., Path], tmp_path: Path
) -> None:
    (tmp_path / "faltering.py").write_text(FALTERING)
    effects = {**COP, "clock": {}, "serial": {"baud": 125_000, "sharing": "mux", "dwell_periods": 2}}
    changes = [
        Override(("cells",), {"firmware": str(tmp_path / "faltering.py")}, ""),
        Override(("effects",), effects, ""),
    ]
    scene = load_scene(str(small()), changes)
    summaries = {way: _go(scene, way, tmp_path) for way in (WAYS[0], WAYS[5], WAYS[6], EACH[1])}
    assert len({one.digest for one in summaries.values()}) == 1, summaries
    counted = [one.effects for one in summaries.values()]
    assert all(one == counted[0] for one in counted)
    assert counted[0]["cop.resets"] > counted[0]["cop.hangs"] >= 8
    assert counted[0]["serial.received"] > 100
    assert all(one.status == "ok" and not one.cells_lost for one in summaries.values())


def test_without_a_watchdog_the_same_cells_are_lost(small: Callable[..., Path], tmp_path: Path) -> None:
    summary = _go(_scene(small()), WAYS[0], tmp_path)
    assert sorted(summary.cells_lost) == [(0, 3), (1, 1)]


@pytest.mark.parametrize("way", [WAYS[0], EACH[0]])
def test_why_a_program_hangs_is_told_once(
    way: Way, small: Callable[..., Path], tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    _go(_scene(small(), **COP), way, tmp_path, quiet=False)
    said = capfd.readouterr().err
    assert said.count("hangs from tick 10 (0.04096 s)") == 1
    assert "this reason are only counted): OverflowError: the counter of periods has run over" in said
    assert "hanging_field.py" in said


def test_a_shard_reports_a_reason_to_hang_once(
    small: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    told: list[tuple[int, int]] = []
    hang = Participant.hang

    def counting(member: Participant, cell: int, tick: int, detail: str) -> None:
        told.append((cell, tick))
        hang(member, cell, tick, detail)

    monkeypatch.setattr(Participant, "hang", counting)
    assert _go(_scene(small(), **COP), WAYS[0], tmp_path).effects["cop.hangs"] == 6
    assert told == [(3, 10)]


def test_a_period_as_long_as_the_timeout_is_refused(small: Callable[..., Path]) -> None:
    with pytest.raises(SceneError, match=r"effects\.cop\.timeout_s = 0\.016384: must be longer than"):
        load_scene(
            str(small()),
            [Override(("effects",), COP, ""), Override(("cells", "period_s"), 0.016384, "")],
        )
