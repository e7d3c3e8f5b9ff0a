"""The plant alone, its wheels at the field's speed."""

from __future__ import annotations

import json
import os
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from deploy.cli import main
from deploy.errors import InputError
from deploy.recordings.digest import Digest
from deploy.recordings.reader import load as load_recording
from deploy.runs.field_simulation import field_speeds, iterate_field_motion, simulate, without_cells
from deploy.runs.run import run
from deploy.scenes.fault_schedule import active
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.util.signals import Interrupted
from deploy.workers.plan import RunOptions
from plant.array import CellArray


def _scene(name: str, **values: object) -> Scene:
    return load_scene(name, [Override((key,), value, "") for key, value in values.items()])


def test_wheel_speeds_are_the_field_at_every_cell() -> None:
    scene = _scene("elliptic")
    positions = CellArray(scene.array).positions_m
    assert np.array_equal(field_speeds(scene, positions), positions * (-1.0, -2.0))


def test_firmware_without_a_field_is_bad_input(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r'cells\.firmware = "heat_diffusion": must be velocity_field'):
        simulate(_scene("heat"), output=tmp_path / "out", quiet=True)
    assert not (tmp_path / "out").exists()


def test_a_simulation_is_sampled_every_period_and_at_its_end(tmp_path: Path) -> None:
    summary = simulate(
        _scene("elliptic", duration_s=0.01), output=tmp_path, picture=False, quiet=True
    ).summary
    assert (summary.status, summary.ticks, summary.simulated_s) == ("ok", 3, 0.01)
    assert json.loads((tmp_path / "summary.json").read_text())["digest"] == summary.digest


def test_the_centre_follows_the_closed_form_of_the_linear_field(tmp_path: Path) -> None:
    scene = _scene("elliptic", duration_s=3.0)
    (parcel,) = simulate(scene, output=tmp_path, picture=False, quiet=True).summary.parcels
    rate = 0.2 * 9.81
    for start, stiffness, reached in ((0.55, 1.0, parcel.position_m[0]), (0.5, 2.0, parcel.position_m[1])):
        # x'' + rate x' + rate stiffness x = 0, from rest
        slow, fast = np.roots([1.0, rate, rate * stiffness])
        expected = start * (fast * np.exp(slow * 3.0) - slow * np.exp(fast * 3.0)) / (fast - slow)
        assert reached == pytest.approx(expected.real, abs=1e-10)


def test_motors_are_left_out_and_that_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    summary = simulate(_scene("motors", duration_s=0.1), output=tmp_path, picture=False).summary
    assert "mdms: effects.motors is left out: mdms simulate has ideal wheels" in capsys.readouterr().err
    assert summary.status == "ok"


def test_effects_of_the_cells_are_left_out_and_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scenes = (
        _scene("elliptic", duration_s=0.02, effects=effects)
        for effects in ({}, {"sensor": {"false_positive": 1.0}, "link_loss": {"probability": 1.0}})
    )
    summaries = [simulate(scene, output=tmp_path, picture=False).summary for scene in scenes]
    said = capsys.readouterr().err
    for name in ("sensor", "link_loss"):
        assert said.count(f"mdms: effects.{name} is left out: mdms simulate has no cells") == 1
    assert summaries[0].digest == summaries[1].digest


def test_a_crash_stops_the_wheels_of_its_cell(tmp_path: Path) -> None:
    faults = [
        {"kind": "crash", "at_s": 0.0, "cell": [r, c]} for r, c in load_scene("elliptic").lattice().cells
    ]
    scene = _scene("elliptic", duration_s=0.5, faults=faults, stall={"policy": "brake"})
    summary = simulate(scene, output=tmp_path, picture=False, quiet=True).summary
    (parcel,) = summary.parcels
    assert parcel.position_m == (0.55, 0.5)
    assert len(summary.cells_lost) == 400


def test_a_crash_under_abort_fails_the_simulation_there(tmp_path: Path) -> None:
    faults = [{"kind": "crash", "at_s": 0.1, "cell": [3, 4]}]
    scene = _scene("elliptic", duration_s=0.5, faults=faults, stall={"policy": "abort"})
    summary = simulate(scene, output=tmp_path, picture=False, quiet=True).summary
    assert summary.status == "failed"
    assert summary.reason == "cell 3,4 crashed at 0.1024 s as scheduled; stall.policy is abort"
    assert summary.simulated_s == pytest.approx(0.1024)


FAULTS = [
    {"kind": "crash", "at_s": 0.1, "until_s": 0.3, "rectangle": [[13, 13], [15, 15]], "wheels": "hold"},
    {"kind": "crash", "at_s": 0.15, "until_s": 0.25, "cell": [12, 14], "wheels": "brake"},
    {"kind": "crash", "at_s": 0.2, "cell": [14, 12]},
    {"kind": "remove", "at_s": 0.15, "until_s": 0.35, "cells": [[14, 14], [15, 14]]},
    {"kind": "add", "at_s": 0.2, "cell": [12, 12]},
    {"kind": "wheel_stuck", "at_s": 0.1, "until_s": 0.2, "cell": [13, 16], "wheel": "x"},
    {"kind": "wheel_reversed", "at_s": 0.25, "share": 0.3},
    {"kind": "wheel_weak", "at_s": 0.05, "until_s": 0.4, "share": 0.2, "strength": 0.5},
    {"kind": "wheel_runaway", "at_s": 0.3, "cell": [13, 13], "way": "negative", "speed_m_s": 0.8},
]
"""Of wheels and modules under the parcel of the scene ``elliptic``."""


@pytest.mark.parametrize("policy", ["coast", "hold"])
def test_faults_do_to_wheels_and_modules_what_they_do_in_a_run(policy: str, tmp_path: Path) -> None:
    scene = _scene("elliptic", duration_s=0.45, faults=FAULTS, stall={"policy": policy})
    options = RunOptions(0, "memory", output=tmp_path / "run", picture=False)
    whole = run(scene, options, quiet=True).summary
    alone = simulate(scene, output=tmp_path / "alone", picture=False, quiet=True).summary
    plain = simulate(_scene("elliptic", duration_s=0.45), output=tmp_path, picture=False, quiet=True).summary
    assert alone.parcels[0].position_m == pytest.approx(whole.parcels[0].position_m, abs=1e-8)
    assert alone.parcels[0].angle_rad == pytest.approx(whole.parcels[0].angle_rad, abs=1e-8)
    assert alone.support_changes == whole.support_changes
    assert alone.parcels[0].angle_rad != pytest.approx(plain.parcels[0].angle_rad, abs=1e-3)
    assert list(alone.cells_lost) == list(whole.cells_lost) == [(14, 12)]
    transitions = [[(f["kind"], f["time_s"]) for f in summary.faults] for summary in (alone, whole)]
    assert transitions[0] == transitions[1]


def test_a_crash_that_would_be_repaired_ends_a_simulation_whose_policy_is_abort(tmp_path: Path) -> None:
    faults = [{"at_s": 0.1, "until_s": 0.2, "cell": [3, 4]}, {"kind": "remove", "at_s": 0.05, "cell": [0, 0]}]
    scene = _scene("elliptic", duration_s=0.5, faults=faults, stall={"policy": "abort"})
    summary = simulate(scene, output=tmp_path, picture=False, quiet=True).summary
    assert summary.reason == "cell 3,4 crashed at 0.1024 s as scheduled; stall.policy is abort"
    assert summary.status == "failed"
    assert [(fault["kind"], fault["cell"]) for fault in summary.faults] == [
        ("remove", [0, 0]),
        ("crash", [3, 4]),
    ]


def test_a_wheel_that_runs_away_does_so_at_the_speed_of_the_motors_that_are_left_out(tmp_path: Path) -> None:
    motors = {"supply_v": 10.0, "speed_per_volt_m_s": 0.05, "coulomb_v": 1.0}
    fault = {"kind": "wheel_runaway", "rectangle": [[0, 0], [19, 19]], "wheel": "x"}
    scene = _scene("elliptic", duration_s=0.05, faults=[fault], effects={"motors": motors})
    simulate(scene, output=tmp_path, picture=False, quiet=True)
    (ideal_fault,) = without_cells(scene).faults
    assert ideal_fault.model_dump()["speed_m_s"] == pytest.approx(0.45)
    ideal_one = _scene("elliptic", duration_s=0.05, faults=[{**fault, "speed_m_s": 0.45}])
    results = [
        simulate(one, output=tmp_path, picture=False, quiet=True).summary for one in (scene, ideal_one)
    ]
    assert results[0].parcels[0].position_m == results[1].parcels[0].position_m
    assert results[0].parcels[0].position_m[0] > 0.55


def test_faults_of_the_cells_are_left_out_and_that_is_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    stuck, hangs = {"kind": "wheel_stuck", "cell": [0, 0]}, {"kind": "hang", "cell": [1, 1]}
    summary = simulate(
        _scene("elliptic", duration_s=0.02, faults=[stuck, hangs]), output=tmp_path, picture=False
    ).summary
    said = capsys.readouterr().err
    assert said.count("mdms: faults[1] (hang) is left out: mdms simulate has no cells") == 1
    assert "faults[0]" not in said
    assert [fault["kind"] for fault in summary.faults] == ["wheel_stuck"]
    assert active(_scene("elliptic", faults=[hangs])) is None


def test_the_digest_is_taken_while_the_simulation_can_be_interrupted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Interrupting(Digest):
        def tick(self, tick: int, *values: NDArray[Any]) -> None:
            super().tick(tick, *values)
            if tick == 5:
                os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr("deploy.runs.field_simulation.Digest", Interrupting)
    scene = _scene("elliptic", duration_s=100.0)
    summary = simulate(scene, output=tmp_path, picture=False, quiet=True).summary
    assert summary.status == "interrupted"
    assert 0.0 < summary.simulated_s < 50.0


def test_a_simulation_is_recorded_sample_by_sample(tmp_path: Path) -> None:
    pulled = {"kind": "remove", "at_s": 0.5, "cell": [10, 10], "until_s": 1.0}
    stuck = {"kind": "wheel_stuck", "at_s": 0.7, "cell": [9, 9]}
    crash = {"kind": "crash", "at_s": 0.3, "cell": [12, 12], "wheels": "brake"}
    scene = _scene("elliptic", duration_s=1.2, faults=[pulled, stuck, crash])
    summary = simulate(scene, output=tmp_path, picture=False, quiet=True).summary
    recording = load_recording(tmp_path)
    assert (recording.status, recording.digest) == ("ok", summary.digest)
    assert len(recording.tick) == summary.ticks + 1
    assert recording.time_ns[-1] == 1_200_000_000
    digest = Digest(b"simulate " + without_cells(scene).canonical())
    for tick, state in enumerate(recording.parcels):
        digest.tick(tick, np.zeros((0, 1), dtype=np.bool_), np.zeros((0, 2)), state)
    assert digest.hexdigest == summary.digest
    assert list(recording.faults) == list(json.loads(json.dumps(summary.faults)))
    assert recording.presence.shape == (len(recording.tick), 400, 0)
    cells, field = recording.header["cells"], field_speeds(scene, CellArray(scene.array).positions_m)
    dead = cells.index([12, 12])
    row = int(np.searchsorted(recording.time_s, 0.3))
    assert np.array_equal(recording.drives[row - 1], field)
    # a crash acts from the first tick that begins at or after its time, on the drives of that instant
    assert np.all(recording.drives[row, dead] == 0.0)
    assert np.array_equal(np.delete(recording.drives[row], dead, axis=0), np.delete(field, dead, axis=0))
    assert np.array_equal(recording.wheel_speeds[row, dead], field[dead])
    assert np.all(recording.wheel_speeds[row + 1, dead] == 0.0)
    assert np.all(recording.wheel_speeds[-1, cells.index([9, 9])] == 0.0)
    assert {event["kind"] for event in recording.events} >= {"support_gained", "support_lost"}


def test_a_recording_of_a_simulation_is_no_run_to_repeat(tmp_path: Path) -> None:
    scene = _scene("elliptic", duration_s=0.01)
    simulate(scene, output=tmp_path, picture=False, quiet=True)
    options = RunOptions(0, "memory", output=tmp_path / "again", picture=False, replay=tmp_path)
    with pytest.raises(InputError, match="is a recording of mdms simulate, which has no cells to repeat"):
        run(scene, options, quiet=True)


def test_an_interrupted_simulation_leaves_a_recording_up_to_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupting(*args: Any, **settings: Any) -> Any:
        for number, part in enumerate(iterate_field_motion(*args, **settings)):
            if number == 2:
                raise Interrupted
            yield part

    monkeypatch.setattr("deploy.runs.field_simulation.iterate_field_motion", interrupting)
    summary = simulate(
        _scene("elliptic", duration_s=100.0), output=tmp_path, picture=False, quiet=True
    ).summary
    recording = load_recording(tmp_path)
    assert recording.status == summary.status == "interrupted"
    assert len(recording.tick) == summary.ticks + 1 == 2001
    assert float(recording.time_s[-1]) == summary.simulated_s


def test_the_same_simulation_has_the_same_digest(tmp_path: Path) -> None:
    first, second, other = (
        simulate(_scene("elliptic", duration_s=d), output=tmp_path, picture=False, quiet=True).summary.digest
        for d in (0.2, 0.2, 0.204)
    )
    assert first == second != other


def test_events_that_have_no_room_in_one_call_are_reported(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    gliding = "{ size_m = [0.5, 0.5], position_m = [-1.0, 0.003], mass_kg = 1.0, velocity_m_s = [0.5, 0.0] }"
    settings = [
        "array={ rows = 30, columns = 130, pitch_m = 0.02 }",
        "cells.parameters={ field = { kind = 'uniform', velocity_m_s = [0.5, 0.0] } }",
        f"parcels=[{gliding}]",
        "duration_s=4.0",
    ]
    sets = [word for setting in settings for word in ("--set", setting)]
    arguments = ["simulate", "elliptic", *sets, "--no-picture", "--json", "--output", str(tmp_path)]
    assert main(arguments) == 0
    summary = json.loads(capsys.readouterr().out)
    assert summary["events_left_out"] > 500
    assert summary["events_left_out"] < summary["support_changes"] - 4000
