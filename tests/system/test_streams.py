"""What goes to stdout and what to stderr."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from tests.system.running import Mdms, summary_of

TALKATIVE = """
from cell_firmware.cell import CellFirmware, CellOutputs

class Talkative(CellFirmware):
    def init(self, cell):
        print("hello from a cell")

    def step(self, state, inputs):
        print("a step")
        return state, CellOutputs((0.0, 0.0))
"""


@pytest.mark.parametrize("processes", ["0", "1"])
def test_with_json_stdout_has_one_object_even_if_the_firmware_prints(
    processes: str, mdms: Callable[..., Mdms], small: Callable[..., Path], tmp_path: Path
) -> None:
    (tmp_path / "talkative.py").write_text(TALKATIVE)
    running = mdms(
        "run", small(), "--processes", processes, "--json", "--duration", "0.01", "--no-picture",
        "--set", f'cells.firmware="{tmp_path / "talkative.py"}"', "--set", "cells.parameters={}",
    )  # fmt: skip
    status, stdout, stderr = running.end()
    assert (status, summary_of(stdout)["status"]) == (0, "ok")
    assert stdout.count("\n") == 1
    assert stderr.count("hello from a cell") == 12
    assert stderr.count("a step") == 36


def test_a_run_that_goes_well_says_nothing_on_a_stderr_that_is_no_terminal(mdms: Callable[..., Mdms]) -> None:
    status, stdout, stderr = mdms("run", "motors", "--duration", "0.05").end()
    assert (status, stderr) == (0, "")
    assert stdout.startswith("motors  ok\n")
