"""What determines the bits of cells, and how a difference is put."""

from __future__ import annotations

import json
from pathlib import Path

from cell_firmware.specs import CellsSpec
from deploy.scenes.files import load_scene
from deploy.scenes.fingerprint import cells_fingerprint, differences, program_fingerprint, scene_differences

PROGRAM = """
import helper
from mdms import CellFirmware, CellOutputs

class East(CellFirmware):
    def init(self, cell):
        return None

    def step(self, state, inputs):
        return state, CellOutputs((helper.SPEED, 0.0))
"""


def test_cells_agree_whatever_their_limits_on_the_wall_clock_and_differ_by_their_scene() -> None:
    scene = load_scene("heat")
    facts = cells_fingerprint(scene)
    assert facts == cells_fingerprint(load_scene("heat").named("elsewhere.toml"))
    patient = scene.model_copy(update={"stall": scene.stall.model_copy(update={"start_s": 600.0})})
    assert cells_fingerprint(patient) == facts
    other = cells_fingerprint(scene.model_copy(update={"seed": 5}))
    assert [name for name in facts if facts[name] != other[name]] == ["the scene"]
    assert cells_fingerprint(load_scene("elliptic"))["the cells' program"] != facts["the cells' program"]


def test_a_program_is_its_file_and_what_it_imports_beside_it(tmp_path: Path) -> None:
    program, helper, other = (tmp_path / name for name in ("program.py", "helper.py", "other.py"))
    program.write_text(PROGRAM)
    helper.write_text("SPEED = 0.1\n")
    other.write_text("")
    cells = CellsSpec(firmware=str(program))
    scene = load_scene("elliptic").model_copy(update={"cells": cells})
    first = program_fingerprint(scene)
    other.write_text("not = imported")
    assert program_fingerprint(scene) == first
    helper.write_text("SPEED = 0.2\n")
    second = program_fingerprint(scene)
    program.write_text(PROGRAM + "\n")
    assert len({first, second, program_fingerprint(scene)}) == 3


def test_a_difference_has_the_other_s_value_first_and_hashes_short() -> None:
    assert differences({"a": "1", "b": "x" * 64}, {"a": "2", "c": "3"}) == [
        "a 2, not 1",
        f"b unknown, not {'x' * 12}",
    ]


def test_scenes_differ_by_their_values_and_anything_may_come_from_the_network() -> None:
    one = json.dumps(
        {"seed": 1, "array": {"rows": 2}, "faults": [{"kind": "crash"}], "list": [1, 2]}
    ).encode()
    other = json.dumps(
        {"seed": 2, "array": {"rows": 3}, "faults": [], "list": [1, 3], "x\x1b": "y" * 99}
    ).encode()
    assert scene_differences(one, other) == [
        "seed 2, not 1",
        "array.rows 3, not 2",
        'faults.0.kind null, not "crash"',
        "and 3 more values",
    ]
    assert scene_differences(one, one) == []
    for garbage in (b"", b"{", b"\xff", b"[" * 100_000):
        assert scene_differences(one, garbage) == []
