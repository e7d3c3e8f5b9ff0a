"""``mdms check-firmware``: every check fails a program that breaks its rule, and says where."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from cell_firmware.loader import BUNDLED
from deploy.cli import main
from deploy.scenes.files import bundled_names, load_scene

GOOD = """
import itertools
import random
import time

import numpy as np

from mdms import CellFirmware, CellOutputs

COUNTER = itertools.count()
SEEN = []


class Echo(CellFirmware):
    message = np.dtype([("n", "u1")])

    def init(self, cell):
        return (cell.row + cell.column, None)

    def step(self, state, inputs):
        n, kept = state
        heard = [message["n"] for message in inputs.inbox.values() if message is not None]
        n = (n + sum(heard) + inputs.presence[0]) % 200
        # here
        return (n, kept), CellOutputs((0.001 * n, 0.0), {side: {"n": n} for side in inputs.inbox})

    def value_ranges(self):
        return {"n": (0, 199)}
"""

BROKEN: Mapping[str, tuple[str, str, str]] = {
    "a clock": ("n += int(time.time_ns()) % 3", "purity", "step calls time.time_ns (echo.py:"),
    "a generator": ("n = random.randrange(100)", "purity", "step draws by random."),
    "numpy's generator": ("n = int(100 * np.random.rand())", "purity", "numpy.random's generator"),
    "a generator of its own": (
        "n = int(np.random.default_rng().integers(100))",
        "purity",
        "draws from the operating",
    ),
    "a global": ("SEEN.append(n)", "purity", "steps change SEEN of echo"),
    "a counter": ("n = next(COUNTER) % 100", "purity", "steps change COUNTER of echo"),
    "an attribute": ("self.last = n", "purity", "steps change self.last"),
    "a class attribute": ("Echo.total = getattr(Echo, 'total', 0) + 1", "purity", "steps change Echo.total"),
    "shared by cells": (
        "n = self.last = (getattr(self, 'last', 0) + n) % 200",
        "one and many",
        " among 9 cells, and ",
    ),
    "hashes of strings": ("n = hash(str(n)) % 200", "repeats", "differs in another process"),
    "an input that is kept": (
        "n, kept = (kept or {'n': n})['n'], inputs.inbox['west']",
        "arguments",
        "the state keeps an input instead of a copy: tick",
    ),
    "an input that is changed": (
        "[message.update(n=0) for message in inputs.inbox.values() if message]",
        "arguments",
        "step changes its inputs",
    ),
    "a value out of range": (
        "n += 20 * inputs.presence[0]",
        "message ranges",
        "outside value_ranges, 0 to 199",
    ),
    "a failure": ("n // (n != 3)", "runs", "ZeroDivisionError"),
}


def checked(
    folder: Path, text: str, capsys: pytest.CaptureFixture[str], *options: str
) -> tuple[int, dict[str, Any]]:
    path = folder / "echo.py"
    path.write_text(text)
    status = main(["check-firmware", str(path), "--json", "--size", "3x3", "--ticks", "30", *options])
    return status, json.loads(capsys.readouterr().out)


@pytest.mark.slow
def test_a_program_without_fault_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    status, found = checked(tmp_path, GOOD, capsys)
    assert (status, found["ok"]) == (0, True)
    assert {one["check"]: one["verdict"] for one in found["checks"]} == {
        "runs": "ok",
        "repeats": "ok",
        "one and many": "ok",
        "forms": "skipped",
        "arguments": "ok",
        "message ranges": "ok",
        "purity": "ok",
    }


@pytest.mark.slow
@pytest.mark.parametrize("name", list(BROKEN))
def test_a_program_with_a_fault_fails_the_check_that_is_about_it(
    name: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line, check, said = BROKEN[name]
    status, found = checked(tmp_path, GOOD.replace("# here", line), capsys)
    assert (status, found["ok"]) == (1, False)
    (verdict,) = [one for one in found["checks"] if one["check"] == check]
    assert verdict["verdict"] == "failed"
    assert said in verdict["detail"]


def test_a_state_that_is_changed_in_place_is_found(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = GOOD.replace("return (cell.row + cell.column, None)", "return [cell.row, None]").replace(
        "        return (n, kept), ", "        state[0] = n\n        return state, "
    )
    status, found = checked(tmp_path, text, capsys)
    assert status == 1
    assert found["checks"][4]["detail"] == "step changes the state that it is given: return a new one"


def test_another_form_that_differs_is_named_with_tick_cell_and_values(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "other.py").write_text(GOOD.replace("% 200", "% 201"))
    status, found = checked(tmp_path, GOOD, capsys, "--against", str(tmp_path / "other.py"))
    assert status == 1
    (forms,) = [one for one in found["checks"] if one["check"] == "forms"]
    assert forms["verdict"] == "failed"
    assert "message field n to the " in forms["detail"] or "speed along x is " in forms["detail"]
    assert " here (cell by cell), and " in forms["detail"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("none.py",), "there is no file"),
        (("heat_diffusion", "--size", "4"), "--size 4: must be ROWSxCOLUMNS, as 4x5"),
        (("heat_diffusion", "--size", "40x40"), "1600 cells: every cell is also stepped alone"),
        (("heat_diffusion", "--set", "ttl_periods=-1"), "ttl_periods"),
    ],
)
def test_bad_input_is_refused(
    arguments: tuple[str, ...], said: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["check-firmware", *arguments]) == 2
    assert said in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.timeout(240)
def test_bundled_programs_pass_in_the_scenes_that_have_them(capsys: pytest.CaptureFixture[str]) -> None:
    scenes = {
        load_scene(name).cells.firmware: name
        for name in bundled_names()
        if len(load_scene(name).lattice()) <= 120
    }
    found: dict[str, str] = {}
    for program, scene in sorted(scenes.items()):
        if program in BUNDLED:
            status = main(["check-firmware", program, "--scene", scene, "--ticks", "20"])
            out = capsys.readouterr().out
            if status:
                found[program] = out
    assert found == {}, "\n".join(found.values())
    assert len(scenes) >= 5
    assert os.environ.get("MDMS_PYTHON_STEPS") is None
