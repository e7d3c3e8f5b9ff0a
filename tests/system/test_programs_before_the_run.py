"""Programs that end the interpreter, fail or never return before tick 0: exit status and message of ``mdms run``."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from deploy.cli import main
from tests.system.small import small_scene

pytestmark = pytest.mark.slow

PROGRAM = """
import sys, time
from cell_firmware.cell import CellFirmware, CellOutputs
from cell_firmware.specs import Spec

{imported}

class Leaving(CellFirmware):
    class Parameters(Spec):
        def __init__(self, **values):
            {parameters}
            super().__init__(**values)

    def __init__(self, parameters):
        {created}
        super().__init__(parameters)

    def check(self, lattice):
        {checked}

    def init(self, cell):
        place = (cell.row, cell.column)
        {begun}
        return None

    def step(self, state, inputs):
        return state, CellOutputs((0.1, 0.0))
"""
ARRAY = """
import sys, time
import numpy as np
from cell_firmware.firmware import Firmware, Outputs
from cell_firmware.specs import Spec

{imported}

class Leaving(Firmware):
    class Parameters(Spec):
        def __init__(self, **values):
            {parameters}
            super().__init__(**values)

    def __init__(self, parameters):
        {created}
        super().__init__(parameters)

    def check(self, lattice):
        {checked}

    def init(self, cells):
        for place in zip(cells.row.tolist(), cells.column.tolist()):
            {begun}
        return {{"n": np.zeros(len(cells))}}

    def step(self, state, inputs):
        return state, Outputs(np.zeros((len(state["n"]), 2)))
"""
WHERE = ("imported", "parameters", "created", "checked", "begun")
both = pytest.mark.parametrize("program", [PROGRAM, ARRAY], ids=["cell", "array"])


def _run(folder: Path, program: str, where: str, body: str, *more: str) -> int:
    """Run a program with a statement at one place; returns the exit status."""
    path, scene = folder / "leaving.py", folder / "small.toml"
    path.write_text(program.format(**{**dict.fromkeys(WHERE, "pass"), where: body}))
    scene.write_text(small_scene())
    arguments = ["run", str(scene), "-q", "--json", "--no-picture", "--output", str(folder / "out")]
    return main([*arguments, "--set", f'cells={{ firmware = "{path}" }}', *more])


@both
@pytest.mark.parametrize("leave", ["sys.exit()", "sys.exit(0)", "sys.exit('enough')"])
@pytest.mark.parametrize(
    ("where", "what"),
    [
        ("imported", "can't be loaded: SystemExit"),
        ("parameters", "Parameters raised SystemExit"),
        ("created", "__init__() raised SystemExit"),
        ("checked", "check() raised SystemExit"),
    ],
)
def test_a_program_that_leaves_before_the_run_is_bad_input(
    where: str, what: str, leave: str, program: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(tmp_path, program, where, leave) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert f"firmware '{tmp_path / 'leaving.py'}'" in shown.err
    assert what in shown.err
    assert f'File "{tmp_path / "leaving.py"}"' in shown.err
    assert leave in shown.err
    assert not (tmp_path / "out").exists()


@both
@pytest.mark.parametrize("processes", ["0", "2"])
@pytest.mark.parametrize("leave", ["sys.exit()", "raise KeyboardInterrupt"])
def test_a_program_that_leaves_in_init_ends_the_run_before_tick_0_by_name(
    leave: str, processes: str, program: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    leaves = f"if place in {{(1, 1), (1, 2)}}: {leave}"
    assert _run(tmp_path, program, "begun", leaves, "--processes", processes) == 1
    shown = capsys.readouterr()
    summary = json.loads(shown.out)
    assert (summary["status"], summary["ticks"]) == ("failed", 0)
    kind = "SystemExit" if "exit" in leave else "KeyboardInterrupt"
    last = shown.err.splitlines()[-1]
    assert f"firmware of cell 1,1 failed in tick 0: init: {kind}" in last
    assert "Traceback" not in last, "the cause is told in a line"
    assert "Traceback (most recent call last):" in shown.err
    assert leaves in shown.err


@pytest.mark.parametrize("processes", ["2", "3", "each"])
def test_of_programs_that_fail_in_init_the_lowest_cell_is_named_whoever_is_faster(
    processes: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fails = "time.sleep(0.6 if place == (0, 1) else 0.0); assert place not in {(0, 1), (1, 3), (2, 3)}, 'odd'"
    assert _run(tmp_path, PROGRAM, "begun", fails, "--processes", processes) == 1
    shown = capsys.readouterr()
    reason = json.loads(shown.out)["reason"]
    assert "firmware of cell 0,1 failed in tick 0: init: AssertionError: odd" in reason
    told = [line for line in shown.err.splitlines() if "firmware of cell" in line]
    assert "cell 0,1" in told[0], "tracebacks come in the same order"


@pytest.mark.parametrize(("processes", "start_s"), [("0", 2.0), ("2", 8.0)])
@pytest.mark.parametrize("how", ["while {}: pass", "if {}: time.sleep(1e6)"], ids=["loops", "sleeps"])
def test_a_program_whose_init_never_returns_is_found_and_named(
    how: str, processes: str, start_s: float, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    waits = how.format("place == (1, 2)")
    more = ("--processes", processes, "--set", f"stall.start_s={start_s}")
    assert _run(tmp_path, PROGRAM, "begun", waits, *more) == 1
    shown = capsys.readouterr()
    summary = json.loads(shown.out)
    assert (summary["status"], summary["ticks"]) == ("failed", 0)
    last = shown.err.splitlines()[-1]
    assert "firmware of cell 1,2 failed in tick 0: init: NeverReturned: " in last
    assert f"had not returned after {0.6 * start_s:g} s (0.6 of stall.start_s)" in last
    assert waits in shown.err


@pytest.mark.slow
def test_a_program_that_fails_just_after_the_start_s_deadline_is_named_all_the_same(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    late = "import threading; time.sleep(7.7 if threading.current_thread().name == 'init' else 0.0)"
    program = PROGRAM.replace("{begun}", "assert place != (1, 2), 'odd'")
    more = ("--processes", "2", "--set", "stall.start_s=8")
    assert _run(tmp_path, program, "imported", late, *more) == 1
    last = capsys.readouterr().err.splitlines()[-1]
    assert "firmware of cell 1,2 failed in tick 0: init: AssertionError: odd" in last
