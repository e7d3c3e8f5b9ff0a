"""The plant alone, its wheels at the field's speed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from deploy.errors import InputError
from deploy.overrides import Override
from deploy.scene import Scene
from deploy.scene_files import load_scene
from deploy.simulate import field_speeds, simulate
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
    assert "mdms: effects.motors is left out: simulate has ideal wheels" in capsys.readouterr().err
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
        assert said.count(f"mdms: effects.{name} is left out: simulate has no cells") == 1
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


def test_the_same_simulation_has_the_same_digest(tmp_path: Path) -> None:
    first, second, other = (
        simulate(_scene("elliptic", duration_s=d), output=tmp_path, picture=False, quiet=True).summary.digest
        for d in (0.2, 0.2, 0.204)
    )
    assert first == second != other
