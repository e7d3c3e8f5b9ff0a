"""A breakpoint in a cell's program: the debugger takes the terminal, and no deadline ends the wait."""

from __future__ import annotations

import json
import os
import pty
import re
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytestmark = [pytest.mark.slow, pytest.mark.timeout(120)]

PROGRAM = """
from mdms import CellFirmware, CellOutputs

class Held(CellFirmware):
    def init(self, cell):
        return {"seen": 0, "own": (cell.row, cell.column) == (1, 1)}

    def step(self, state, inputs):
        if state["own"] and state["seen"] == 5:
            breakpoint()
        return {**state, "seen": state["seen"] + 1}, CellOutputs((0.1, 0.0))
"""

COMMAND = [
    "-c", "from deploy.cli import main; main()", "run", "elliptic", "--duration", "0.1", "--no-picture", "--json",
    "--set", "cells.parameters={}", "--set", "stall.deadline_s=0.3", "--set", "stall.policy='abort'",
]  # fmt: skip


def run_in_a_terminal(folder: Path, processes: str, hold_s: float) -> tuple[str, dict[str, object]]:
    """Run with a terminal; let the debugger wait, then go on. Returns what the terminal showed, and the summary."""
    (folder / "held.py").write_text(PROGRAM)
    result = folder / "summary.txt"
    command = [
        sys.executable, *COMMAND, "--processes", processes, "--set", f"cells.firmware='{folder / 'held.py'}'",
        "--output", str(folder / "run"),
    ]  # fmt: skip
    child, terminal = pty.fork()
    if child == 0:
        with result.open("wb") as file:
            os.dup2(file.fileno(), 1)
        os.execvp(command[0], command)
    shown, said = "", False
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        if not select.select([terminal], [], [], 0.2)[0]:
            continue
        try:
            shown += os.read(terminal, 65_536).decode()
        except OSError:  # the child has ended
            break
        if not said and "(Pdb)" in shown:
            said = True
            time.sleep(hold_s)
            os.write(terminal, b"p state['seen']\nc\n")
    os.close(terminal)
    os.waitpid(child, 0)
    return shown, json.loads(result.read_text())


@pytest.mark.parametrize("processes", ["2", "0"])
def test_a_debugger_holds_a_cell_for_longer_than_any_deadline(tmp_path: Path, processes: str) -> None:
    shown, summary = run_in_a_terminal(tmp_path, processes, hold_s=3.5)
    assert "(Pdb)" in shown
    assert re.search(r"\b5\r?\n", shown)
    assert summary["status"] == "ok", shown
    assert "cell 1,1 is held in a debugger at tick 5: deadlines are suspended" in shown


def test_without_a_terminal_a_breakpoint_in_a_worker_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "held.py").write_text(PROGRAM)
    command = [
        sys.executable, *COMMAND, "--processes", "1", "--set", f"cells.firmware='{tmp_path / 'held.py'}'",
        "--output", str(tmp_path / "run"),
    ]  # fmt: skip
    done = subprocess.run(
        command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False, start_new_session=True
    )
    assert json.loads(done.stdout)["status"] == "ok", done.stderr
    assert "breakpoint() is ignored: there is no terminal" in done.stderr
