"""``mdms step``: a recorded step again, exactly; and output of programs that names cell and tick."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from deploy.cli import main
from deploy.errors import InputError
from deploy.recordings.format import CONTROL
from deploy.recordings.reader import load
from deploy.runs.step_again import held_step
from tests.system.test_random_numbers import GAMBLER, scene

EFFECTS = """
[effects]
link_loss = { probability = 0.2 }
clock = { error_ppm = 20000 }
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run with random numbers, lost messages and clocks of the cells' own."""
    folder = tmp_path_factory.mktemp("recorded")
    scene(folder)
    path = folder / "gamble.toml"
    path.write_text(path.read_text() + EFFECTS)
    command = ["run", str(path), "--processes", "0", "--transport", "memory", "--registers", "--no-picture"]
    assert main([*command, "--output", str(folder / "out"), "--json"]) == 0
    return folder / "out"


def test_a_step_again_comes_to_the_recorded_state(recorded: Path) -> None:
    recording = load(recorded)
    cells = [tuple(cell) for cell in recording.header["cells"]]
    states = recording.registers["firmware.state"]
    for cell, tick in (((1, 1), 12), ((0, 3), 20), ((2, 0), 7)):
        held = held_step(recording, cell, tick)
        bank, _ = held.step(held.state, held.inputs)
        row = int(np.flatnonzero(recording.register_tick == tick)[0])
        assert states[row - 1, cells.index(cell)] == held.state
        assert states[row, cells.index(cell)] == bank
        assert held.inputs.random.keys() == {"turn", "stake"}


def test_a_program_that_has_changed_is_refused_with_tick_cell_and_drives(recorded: Path) -> None:
    program = recorded.parent / "gambler.py"
    program.write_text(GAMBLER.replace("0.01 * bank", "0.02 * bank"))
    try:
        with pytest.raises(
            InputError, match=r"tick \d+, cell 0,0: the drive is .* now, and was .*has changed since"
        ):
            held_step(load(recorded), (1, 1), 20)
    finally:
        program.write_text(GAMBLER)


def test_a_program_that_is_gone_is_named_by_its_file(recorded: Path) -> None:
    program = recorded.parent / "gambler.py"
    program.unlink()
    try:
        with pytest.raises(
            InputError,
            match=r"its scene can't be run: cells.firmware: firmware '.*': there is no file .*gambler.py$",
        ):
            held_step(load(recorded), (1, 1), 20)
    finally:
        program.write_text(GAMBLER)


@pytest.mark.parametrize(
    ("cell", "tick", "said"),
    [
        ("9,9", "3", "--cell 9,9: the recording has no such cell"),
        ("1,1", "900", "--tick 900: the recording has ticks 0 to 24"),
        ("1", "3", "--cell 1: must be ROW,COLUMN"),
    ],
)
def test_a_step_that_is_not_there_is_bad_input(
    cell: str, tick: str, said: str, recorded: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["step", str(recorded), "--cell", cell, "--tick", tick]) == 2
    assert said in capsys.readouterr().err


def test_a_run_with_live_faults_is_refused(recorded: Path) -> None:
    recording = load(recorded)
    object.__setattr__(recording, CONTROL.strip("/"), [{"time_s": 0.0, "kind": "fault", "detail": {}}])
    with pytest.raises(InputError, match="fault came while the run went on"):
        held_step(recording, (1, 1), 3)


@pytest.mark.slow
def test_the_debugger_stops_in_the_step_of_that_cell(recorded: Path) -> None:
    command = [sys.executable, "-m", "deploy.cli", "step", str(recorded), "--cell", "1,1", "--tick", "12"]
    done = subprocess.run(
        command, input="p round(bank, 9)\nn\nc\n", capture_output=True, text=True, check=True, timeout=60
    )
    held = held_step(load(recorded), (1, 1), 12)
    assert "gambler.py" in done.stdout
    assert f"(Pdb) {round(held.state, 9)}\n" in done.stdout
    assert f"result:  ({held.step(held.state, held.inputs)[0]!r}, CellOutputs(" in done.stdout


TALKER = """
import logging, sys
from mdms import CellFirmware, CellOutputs

class Talker(CellFirmware):
    def init(self, cell):
        return (cell.row, cell.column, 0)

    def step(self, state, inputs):
        row, column, ticks = state
        if (row, column, ticks) == (1, 2, 3):
            print("one\\ntwo")
            print("three", file=sys.stderr)
            logging.warning("four")
        if (row, column, ticks) == (0, 1, 5):
            sys.exit(0)
        return (row, column, ticks + 1), CellOutputs((0.0, 0.0))
"""


@pytest.mark.parametrize("processes", ["0", pytest.param("2", marks=pytest.mark.slow)])
def test_output_names_cell_and_tick_and_sys_exit_fails_its_cell(processes: str, tmp_path: Path) -> None:
    scene(tmp_path)
    (tmp_path / "gambler.py").write_text(TALKER)
    command = [
        sys.executable,
        "-m",
        "deploy.cli",
        "run",
        str(tmp_path / "gamble.toml"),
        "--no-picture",
        "--json",
    ]
    done = subprocess.run(
        [*command, "--processes", processes, "--output", str(tmp_path / "out")],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    lines = done.stderr.splitlines()
    for line in ("one", "two", "three", "WARNING:root:four"):
        assert f"cell 1,2, tick 3: {line}" in lines
    assert done.returncode == 1
    assert json.loads(done.stdout)["status"] == "failed"
    assert "cell 0,1 failed in tick 5" in done.stderr
    assert "SystemExit" in done.stderr
