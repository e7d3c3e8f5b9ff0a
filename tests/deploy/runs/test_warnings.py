"""What a firmware says will go wrong is said before anything starts, and kept in the summary."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from cell_firmware.errors import FirmwareError
from deploy.cli import main
from deploy.runs.setup import prepare_run, warnings_of
from deploy.scenes.files import load_scene
from deploy.scenes.overrides import Override
from deploy.scenes.scene import Scene
from deploy.workers.plan import RunOptions

FIRMWARE = """
from cell_firmware.cell import CellFirmware, CellOutputs

class Worried(CellFirmware):
    def init(self, cell):
        return None

    def step(self, state, inputs):
        return state, CellOutputs((0.0, 0.0))

    def warnings(self, lattice):
        return (f"{len(lattice)} cells are too many: nothing will move",)


class Confused(Worried):
    def warnings(self, lattice):
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


def test_warnings_come_before_the_start_and_in_the_summary(
    worried: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = "200 cells are too many: nothing will move"
    run = ["run", "heat", *overrides(f"{worried}:Worried"), "--processes", "0", "--transport", "memory"]
    run += ["--no-picture", "--output", str(tmp_path / "out")]
    assert main([*run, "--json"]) == 0
    shown = capsys.readouterr()
    assert shown.err.splitlines()[0] == f"mdms: warning: {line}"
    assert json.loads(shown.out)["warnings"] == [line]
    assert main([*run, "--quiet"]) == 0
    shown = capsys.readouterr()
    assert line not in shown.err
    assert line in " ".join(shown.out.split())


def test_a_study_of_effects_says_them_once(
    worried: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("deploy.studies.effects.study.effect_types", dict)  # it has nothing to toggle
    changes = overrides(f"{worried}:Worried")
    assert main(["effects", "heat", *changes, "--repeats", "1", "--json"]) == 0
    assert capsys.readouterr().err.count("warning: 200 cells are too many") == 1


def test_a_firmware_that_can_not_say_is_bad_input_with_its_traceback(worried: str) -> None:
    scene = load_scene("heat")
    cells = scene.cells.model_copy(update={"firmware": f"{worried}:Confused", "parameters": {}})
    with pytest.raises(
        FirmwareError, match=r"(?s): warnings\(\) raised ZeroDivisionError: pitch\n.*worried.py.*pitch$"
    ):
        warnings_of(Scene.model_validate({**dict(scene), "cells": cells}))


def test_bundled_scenes_have_nothing_to_be_careful_of() -> None:
    for name in ("heat", "elliptic", "serial", "potential", "prototype", "breadboard"):
        assert warnings_of(load_scene(name)) == ()


QUIET = """
from cell_firmware.cell import CellFirmware, CellOutputs


class Quiet(CellFirmware):
    def init(self, cell):
        return {"left": 3, "name": "cell"}

    def step(self, state, inputs):
        return state, CellOutputs((0.0, 0.0))
"""


def test_what_of_a_plain_program_is_not_recorded_is_said_before_the_run(tmp_path: Path) -> None:
    path = tmp_path / "quiet.py"
    path.write_text(QUIET, encoding="utf-8")
    scene = load_scene("elliptic")
    cells = scene.cells.model_copy(update={"firmware": str(path), "parameters": {}})
    plain = Scene.model_validate({**dict(scene), "cells": cells})
    line = "--registers: quiet.py: parts of its state are not recorded: name is a str, not numbers"
    assert prepare_run(plain, RunOptions(0, "memory", registers=1), None).warnings == (line,)
    assert prepare_run(plain, RunOptions(0, "memory"), None).warnings == ()
    assert prepare_run(scene, RunOptions(0, "memory", registers=1), None).warnings == ()


def processor(*changes: str, name: str = "prototype") -> tuple[str, ...]:
    return warnings_of(load_scene(name, [Override.parse(change) for change in changes]))


def test_boards_that_no_processor_could_serve_are_reported_with_what_takes_its_time() -> None:
    (line,) = processor("effects.serial={ baud = 31250 }")
    assert line == (
        "an MC68HC11 would be busy for 121 to 133 % of a control period of 8,192 E: speed loops 16 to 28 %, PWM 5 %, "
        "serial bytes at 31,250 baud with 8 lines busy 100 %; the emulation ignores this load, but a real board "
        "would miss periods and bytes"
    )
    (edges,) = processor(
        "effects.serial={ baud = 31250 }", "effects.encoder={ counts_per_revolution = 1920 }"
    )
    assert "for 144 to 155 % of a control period" in edges
    assert "45 edges of the second wheel's encoder at top speed 23 %" in edges
    (fast,) = processor("effects.serial={ baud = 125000 }")
    assert "for 421 to 433 % of" in fast


def test_boards_that_have_the_time_are_not_reported() -> None:
    assert processor() == ()
    assert processor('cells.board={ name = "hc11", without = ["fixed_point"] }') == ()
    assert processor("effects.serial={ baud = 31250, ring_bytes = 0 }") == ()
    assert processor('effects.serial={ baud = 31250, sharing = "mux", dwell_periods = 8 }') == ()


def test_a_decoder_chip_changes_nothing_that_is_simulated() -> None:
    assert load_scene("prototype").effects.encoder is not None
    own = load_scene("prototype", [Override.parse("effects.encoder={ counts_per_revolution = 1920 }")])
    assert own.canonical() == load_scene("prototype").canonical()
