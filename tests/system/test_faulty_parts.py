"""Faults of wheels, and modules that are pulled and plugged in, in the whole system."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from deploy.recordings.reader import load
from deploy.recordings.recording import Recording
from deploy.runs.run import run
from deploy.runs.summary import Summary
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import Processes, RunOptions, Transport

Small = Callable[[str], Path]
PERIOD_S = 0.004096

HEARERS = """
import numpy as np
from cell_firmware.cell import CellFirmware, CellOutputs

class Hearers(CellFirmware):
    message = np.dtype([("steps", "<i8")])

    def init(self, cell):
        return 0

    def step(self, steps, inputs):
        heard = sum(message is not None for message in inputs.inbox.values())
        drive = 0.001 * (steps + 1), 0.01 * heard
        return steps + 1, CellOutputs(drive, dict.fromkeys(inputs.inbox, {"steps": steps}))
"""
"""Wheels along x tell how long a program has run, those along y how many neighbours it hears."""

FAULTS: list[dict[str, Any]] = [
    {"kind": "remove", "at_s": 0.02, "until_s": 0.05, "cell": [1, 1]},
    {"kind": "remove", "at_s": 0.03, "cells": [[0, 2], [1, 1]]},
    {"kind": "add", "at_s": 0.04, "cell": [2, 0]},
    {"kind": "crash", "at_s": 0.01, "until_s": 0.05, "cell": [1, 0], "wheels": "hold"},
    {"kind": "crash", "at_s": 0.06, "cell": [0, 1], "wheels": "brake"},
    {"kind": "wheel_stuck", "at_s": 0.015, "until_s": 0.07, "rectangle": [[2, 1], [2, 2]], "wheel": "x"},
    {"kind": "wheel_weak", "at_s": 0.02, "strength": 0.3, "most_m_s": 0.5, "share": 0.5},
    {"kind": "wheel_reversed", "at_s": 0.01, "until_s": 0.03, "cell": [0, 0]},
    {
        "kind": "wheel_runaway",
        "at_s": 0.03,
        "way": "negative",
        "speed_m_s": 0.2,
        "cell": [1, 2],
        "wheel": "y",
    },
]


@pytest.fixture
def scene_of(small: Small, tmp_path: Path) -> Callable[..., Scene]:
    def make(faults: list[dict[str, Any]], **more: object) -> Scene:
        (tmp_path / "hearers.py").write_text(HEARERS)
        changes: dict[str, object] = {"cells": {"firmware": str(tmp_path / "hearers.py")}, "faults": faults}
        changes["parcels"] = [{"size_m": [0.36, 0.28], "mass_kg": 1.0, "position_m": [0.0, 0.0]}]
        changes |= more
        return load_scene(str(small("")), [Override((key,), value, "") for key, value in changes.items()])

    return make


def ran(
    scene: Scene, folder: Path, processes: Processes = 0, transport: Transport = "memory"
) -> tuple[Summary, Recording]:
    options = RunOptions(processes, transport, output=folder, picture=False)
    summary = run(scene, options, quiet=True).summary
    assert summary.status == "ok", summary.reason
    return summary, load(folder)


def ticks(at_s: float) -> int:
    """The first tick that doesn't begin before a time."""
    return int(np.ceil(at_s / PERIOD_S))


@pytest.mark.slow
@pytest.mark.parametrize("clocks", [False, True], ids=["in step", "clocks of their own"])
def test_harm_is_done_alike_however_the_scene_is_cut(
    clocks: bool, scene_of: Callable[..., Scene], tmp_path: Path
) -> None:
    effects: dict[str, object] = {"clock": {"error_ppm": 20_000.0}} if clocks else {}
    scene = scene_of(FAULTS, effects=effects)
    ways: list[tuple[Processes, Transport]] = [(0, "memory"), (2, "zenoh")]
    if not clocks:
        ways.append(("each", "zenoh"))
    summaries = [ran(scene, tmp_path, *way)[0] for way in ways]
    assert len({summary.digest for summary in summaries}) == 1
    told = [[{**fault, "detail": ""} for fault in summary.faults] for summary in summaries]
    assert all(one == told[0] for one in told)
    assert all(summary.parcels[0].state == "moving" for summary in summaries)
    assert summaries[0].support_changes >= 4
    assert {fault["kind"] for fault in told[0]} == {fault["kind"] for fault in FAULTS}


def test_a_cell_that_is_pulled_is_silent_and_begins_anew_when_it_is_plugged_in(
    scene_of: Callable[..., Scene], tmp_path: Path
) -> None:
    out, again = ticks(0.02), ticks(0.05)
    scene = scene_of([{"kind": "remove", "at_s": 0.02, "until_s": 0.05, "cell": [1, 1]}])
    _, recorded = ran(scene, tmp_path)
    middle, beside = scene.lattice().index((1, 1)), scene.lattice().index((0, 1))
    drives = recorded.drives
    assert drives[out - 1, middle, 0] == pytest.approx(0.001 * out)
    assert np.all(drives[out:again, middle] == 0.0)
    assert np.all(recorded.wheel_speeds[out:again, middle] == 0.0)
    assert not recorded.presence[out:again, middle].any()
    assert recorded.presence[out - 1, middle].all()
    assert recorded.presence[again, middle].all()
    assert drives[again : again + 3, middle, 0] == pytest.approx([0.001, 0.002, 0.003])
    # what it said last is heard a tick later, and nothing from then on until it speaks again
    heard = np.round(drives[:-1, beside, 1] / 0.01).astype(int)
    assert set(heard[1 : out + 1]) == {3}
    assert set(heard[out + 1 : again + 1]) == {2}
    assert set(heard[again + 1 :]) == {3}


def test_a_cell_that_is_added_is_not_there_before(scene_of: Callable[..., Scene], tmp_path: Path) -> None:
    comes = ticks(0.04)
    scene = scene_of([{"kind": "add", "at_s": 0.04, "cell": [1, 1]}])
    summary, recorded = ran(scene, tmp_path)
    middle = scene.lattice().index((1, 1))
    assert np.all(recorded.drives[:comes, middle] == 0.0)
    assert not recorded.presence[:comes, middle].any()
    assert recorded.drives[comes, middle, 0] == pytest.approx(0.001)
    assert [(fault["kind"], fault["phase"], fault["tick"]) for fault in summary.faults] == [
        ("add", "begins", 0),
        ("add", "ends", comes),
    ]


def test_drives_that_are_recorded_are_those_of_the_cells_and_speeds_those_of_the_wheels(
    scene_of: Callable[..., Scene], tmp_path: Path
) -> None:
    fault = {"kind": "wheel_reversed", "at_s": 0.02, "cell": [1, 1]}
    _, plain = ran(scene_of([]), tmp_path / "plain")
    _, recorded = ran(scene_of([fault]), tmp_path / "reversed")
    assert np.array_equal(recorded.drives, plain.drives)
    middle, begins = scene_of([]).lattice().index((1, 1)), ticks(0.02)
    assert np.array_equal(recorded.wheel_speeds[:begins], plain.wheel_speeds[:begins])
    assert np.array_equal(recorded.wheel_speeds[begins:, middle], -plain.wheel_speeds[begins:, middle])
    assert not np.array_equal(recorded.parcels, plain.parcels)


@pytest.mark.parametrize("until_s", [None, 0.05])
def test_what_the_wheels_of_a_cell_do_that_crashes_may_be_said_by_its_fault(
    until_s: float | None, scene_of: Callable[..., Scene], tmp_path: Path
) -> None:
    dies, repaired = ticks(0.02), ticks(0.05)
    faults = [
        {"kind": "crash", "at_s": 0.02, "cell": [1, column], **more}
        | ({"until_s": until_s} if until_s else {})
        for column, more in enumerate(({"wheels": "hold"}, {"wheels": "brake"}, {}))
    ]
    for policy, given in (("hold", 1.0), ("brake", 0.0)):
        scene = scene_of(faults, stall={"policy": policy})
        _, recorded = ran(scene, tmp_path / policy)
        hold, brake, as_said = (scene.lattice().index((1, column)) for column in range(3))
        last = recorded.drives[dies - 1, hold]
        end = repaired if until_s else len(recorded.drives)
        assert np.all(recorded.drives[dies:end, hold] == last)
        assert np.all(recorded.drives[dies:end, brake] == 0.0)
        assert np.all(recorded.drives[dies:end, as_said] == given * recorded.drives[dies - 1, as_said])
        if until_s:
            assert recorded.drives[repaired, [hold, brake, as_said], 0] == pytest.approx(0.001)


def test_a_module_that_is_pulled_ends_no_run_whose_policy_is_abort(
    scene_of: Callable[..., Scene], tmp_path: Path
) -> None:
    pulled = [{"kind": "remove", "at_s": 0.02, "cell": [0, 0]}]
    assert ran(scene_of(pulled, stall={"policy": "abort"}), tmp_path)[0].cells_lost == []
