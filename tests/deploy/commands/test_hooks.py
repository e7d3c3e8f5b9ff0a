"""A hook of a program that raises is one refusal that names the firmware and the hook, before anything starts."""

from __future__ import annotations

from pathlib import Path

import pytest

from cell_firmware.errors import FirmwareError, ParametersError, Problem
from cell_firmware.hooks import HOOKS
from cell_firmware.loader import load
from cell_firmware.specs import CellsSpec
from deploy.cli import main
from tests.system.small import small_scene

PROGRAM = """
import sys
from cell_firmware.cell import CellFirmware, CellOutputs

class Hooked(CellFirmware):
    def init(self, cell):
        return None

    def step(self, state, inputs):
        return state, CellOutputs((0.0, 0.0))

    def {hook}(self, *arguments):
        {body}
"""
ARRAY = """
import sys
import numpy as np
from cell_firmware.firmware import Firmware, Outputs

class Hooked(Firmware):
    def init(self, cells):
        return {{"n": np.zeros(len(cells))}}

    def step(self, state, inputs):
        return state, Outputs(np.zeros((len(state["n"]), 2)))

    def {hook}(self, *arguments):
        {body}
"""
ARGUMENTS = {"check": 1, "check_geometry": 3, "warnings": 1, "theory": 1}
BEFORE = [hook for hook in HOOKS if hook != "value_ranges"]
"""Of no use to a run before messages come."""


def written(folder: Path, hook: str, body: str, program: str = PROGRAM) -> Path:
    path = folder / "hooked.py"
    path.write_text(program.format(hook=hook, body=body))
    return path


@pytest.mark.parametrize("program", [PROGRAM, ARRAY], ids=["cell", "array"])
@pytest.mark.parametrize(
    ("body", "raised"),
    [
        ("sys.exit()", "SystemExit"),
        ("sys.exit('enough')", "SystemExit: enough"),
        ("raise KeyError('k')", "KeyError: 'k'"),
    ],
)
@pytest.mark.parametrize("hook", BEFORE)
def test_a_run_is_refused_with_the_firmware_the_hook_and_what_it_raised(
    hook: str, body: str, raised: str, program: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, scene, output = written(tmp_path, hook, body, program), tmp_path / "small.toml", tmp_path / "out"
    scene.write_text(small_scene())
    settings = ["--set", f'cells={{ firmware = "{path}" }}', "--output", str(output), "--protocol-report"]
    assert main(["run", str(scene), "--processes", "0", "--transport", "memory", *settings]) == 2
    said = capsys.readouterr().err
    first = said.splitlines()[0]
    assert f"firmware '{path}': {hook}() raised {raised}" in first
    assert f'File "{path}"' in said
    assert said.endswith(f"{raised}\n")
    assert "this is a bug" not in said
    assert not output.exists()


@pytest.mark.parametrize("hook", HOOKS)
def test_a_refusal_in_the_author_s_own_words_stays_as_it_is(hook: str, tmp_path: Path) -> None:
    body = "from cell_firmware.errors import FirmwareError; raise FirmwareError('not on a Monday')"
    program = load(CellsSpec(firmware=str(written(tmp_path, hook, body))))
    with pytest.raises(FirmwareError, match=r"^not on a Monday$"):
        getattr(program, hook)(*[None] * ARGUMENTS.get(hook, 0))


def test_problems_of_parameters_keep_their_paths(tmp_path: Path) -> None:
    body = (
        "from cell_firmware.errors import ParametersError, Problem; "
        "raise ParametersError('it', (Problem(('gain',), 'is odd', 3),))"
    )
    program = load(CellsSpec(firmware=str(written(tmp_path, "required_effects", body))))
    with pytest.raises(ParametersError) as refused:
        program.required_effects()
    assert refused.value.problems == (Problem(("gain",), "is odd", 3),)


def test_the_cause_is_preserved(tmp_path: Path) -> None:
    program = load(
        CellsSpec(firmware=str(written(tmp_path, "value_ranges", "raise ModuleNotFoundError('scipy')")))
    )
    with pytest.raises(FirmwareError, match=r"value_ranges\(\) raised ModuleNotFoundError: scipy") as refused:
        program.value_ranges()
    assert isinstance(refused.value.__cause__, ModuleNotFoundError)
