"""The code in docs/firmware.md is run as it stands."""

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.loader import load
from cell_firmware.specs import CellsSpec

PAGE = (Path(__file__).parents[2] / "docs" / "firmware.md").read_text(encoding="utf-8")
PLAIN, ARRAYS, SCALAR, TRIAL = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for code in (PLAIN, ARRAYS, SCALAR):
        name = code.splitlines()[0].removeprefix("# ")
        (tmp_path / name).write_text(code, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    return tmp_path


def test_the_trial_prints_what_the_page_says(folder: Path, capsys: pytest.CaptureFixture[str]):
    exec(compile(TRIAL, "docs/firmware.md", "exec"), {})
    said = re.findall(r"  # (\(.*)$", TRIAL, re.MULTILINE)
    assert len(said) == 2
    assert capsys.readouterr().out.splitlines() == said


@pytest.mark.parametrize(
    ("name", "in_python"),
    [
        ("fast_conveyor.py", ""),
        ("scalar_conveyor.py", "1"),
        pytest.param("scalar_conveyor.py", "", marks=pytest.mark.slow),
    ],
)
def test_the_plain_conveyor_and_the_others_are_the_same_program_to_the_last_bit(
    name: str,
    in_python: str,
    folder: Path,
    grid: Callable[..., Lattice],
    run: Callable[..., Any],
    monkeypatch: pytest.MonkeyPatch,
):
    monkeypatch.setenv("MDMS_PYTHON_STEPS", in_python)
    lattice = grid(3, 6, missing=[(1, 4)])
    presence = np.random.default_rng(1).random((60, len(lattice), 1)) < 0.03
    parameters = {"linger_s": 0.03}
    drives = [
        run(
            load(CellsSpec(firmware=name, parameters=parameters)),
            Partition.even(lattice, 3),
            60,
            presence=presence,
        )
        for name in ("conveyor.py", name)
    ]
    assert not drives[0].failures
    assert not drives[1].failures
    assert drives[0].drives.tobytes() == drives[1].drives.tobytes()
    assert 0 < np.count_nonzero(drives[0].drives) < drives[0].drives.size / 2


def test_every_bundled_firmware_and_every_field_is_on_the_page():
    from typing import get_args

    from cell_firmware.fields import FieldSpec
    from cell_firmware.loader import BUNDLED

    kinds = [field.model_fields["kind"].default for field in get_args(get_args(FieldSpec)[0])]
    for name in (*BUNDLED, *kinds):
        assert f"| `{name}` |" in PAGE
