"""What a firmware says will go wrong is said before anything starts, and kept in the summary."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deploy.cautions import cautions_of
from deploy.cli import main
from deploy.errors import InputError
from deploy.scene import Scene
from deploy.scene_files import load_scene

FIRMWARE = """
from cell_firmware.cell import CellFirmware, CellOutputs

class Worried(CellFirmware):
    def init(self, cell):
        return None

    def step(self, state, inputs):
        return state, CellOutputs((0.0, 0.0))

    def cautions(self, lattice):
        return (f"{len(lattice)} cells are too many: nothing will move",)


class Confused(Worried):
    def cautions(self, lattice):
        raise ZeroDivisionError("pitch")
"""


@pytest.fixture
def worried(tmp_path: Path) -> str:
    """The path of a firmware that has something to say."""
    path = tmp_path / "worried.py"
    path.write_text(FIRMWARE)
    return str(path)


def overrides(firmware: str) -> list[str]:
    values = {"cells.firmware": f'"{firmware}"', "cells.parameters": "{}", "duration_s": "0.02"}
    return [word for key, value in values.items() for word in ("--set", f"{key}={value}")]


def test_cautions_come_before_the_start_and_in_the_summary(
    worried: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = "200 cells are too many: nothing will move"
    run = ["run", "heat", *overrides(f"{worried}:Worried"), "--processes", "0", "--transport", "memory"]
    run += ["--no-picture", "--output", str(tmp_path / "out")]
    assert main([*run, "--json"]) == 0
    shown = capsys.readouterr()
    assert shown.err.splitlines()[0] == f"mdms: caution: {line}"
    assert json.loads(shown.out)["cautions"] == [line]
    assert main([*run, "--quiet"]) == 0
    shown = capsys.readouterr()
    assert line not in shown.err
    assert line in " ".join(shown.out.split())


def test_a_study_of_effects_says_them_once(
    worried: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("deploy.effect_study.study.effect_types", dict)  # it has nothing to toggle
    changes = overrides(f"{worried}:Worried")
    assert main(["effects", "heat", *changes, "--repeats", "1", "--json"]) == 0
    assert capsys.readouterr().err.count("caution: 200 cells are too many") == 1


def test_a_firmware_that_can_not_say_is_bad_input_with_its_traceback(worried: str) -> None:
    scene = load_scene("heat")
    cells = scene.cells.model_copy(update={"firmware": f"{worried}:Confused", "parameters": {}})
    with pytest.raises(InputError, match=r"(?s)can't say what to be careful of:.*worried.py.*pitch$"):
        cautions_of(Scene.model_validate({**dict(scene), "cells": cells}))


def test_bundled_scenes_have_nothing_to_be_careful_of() -> None:
    for name in ("heat", "elliptic", "serial", "potential"):
        assert cautions_of(load_scene(name)) == ()
