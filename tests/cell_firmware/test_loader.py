import re
import sys
from pathlib import Path
from typing import Any

import pytest

from cell_firmware.cell import PerCellAdapter, records_of
from cell_firmware.errors import FirmwareError, ParametersError
from cell_firmware.loader import BUNDLED, find, load
from cell_firmware.protocols.heat_diffusion import HeatDiffusion
from cell_firmware.protocols.velocity_field import VelocityField
from cell_firmware.specs import CellsSpec

PLAIN = """
from cell_firmware.cell import CellFirmware, CellOutputs

class Still(CellFirmware):
    def init(self, cell):
        return None

    def step(self, state, inputs):
        return None, CellOutputs((0.0, 0.0))
"""


def write(folder: Path, text: str, name: str = "mine.py") -> str:
    (folder / name).write_text(text, encoding="utf-8")
    return name


def test_bundled_firmware_is_found_by_name():
    assert find("velocity_field") is VelocityField
    assert find("heat_diffusion") is HeatDiffusion


@pytest.mark.parametrize("name", BUNDLED)
def test_every_bundled_name_leads_to_a_class(name: str):
    assert find(name).__doc__


def test_an_importable_class_is_found_by_its_place():
    assert find("cell_firmware.protocols.heat_diffusion:HeatDiffusion") is HeatDiffusion


def test_a_file_is_found_relative_to_the_folder_and_plain_firmware_is_adapted(tmp_path: Path):
    name = write(tmp_path, PLAIN)
    for place in (name, f"{name}:Still", str(tmp_path / name)):
        assert isinstance(load(CellsSpec(firmware=place), tmp_path), PerCellAdapter)


def test_an_unknown_name_is_answered_with_the_nearest_and_all_known():
    with pytest.raises(FirmwareError) as caught:
        find("velocity_feild")
    assert str(caught.value) == (
        "unknown firmware 'velocity_feild'; did you mean 'velocity_field'? "
        f"Known: {', '.join(sorted(BUNDLED))}; "
        "or package.module:Class, or a path to a .py file"
    )


@pytest.mark.parametrize(
    ("place", "message"),
    [
        ("no_such_package.module:Class", "there is no module 'no_such_package' to import"),
        ("cell_firmware.nothing:Class", "there is no module 'cell_firmware.nothing' to import"),
        ("cell_firmware.specs:CellsSpec", "is not a subclass of Firmware or CellFirmware"),
        (
            "cell_firmware.protocols.heat_diffusion:Heat",
            "cell_firmware.protocols.heat_diffusion has no Heat; it has HeatDiffusion",
        ),
        ("absent.py", "there is no file"),
    ],
)
def test_a_place_without_firmware_is_refused_with_the_reason(place: str, message: str, tmp_path: Path):
    with pytest.raises(FirmwareError, match=message):
        find(place, tmp_path)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("x = 1\n", "expected one Firmware or CellFirmware class, found none"),
        (PLAIN + PLAIN.replace("Still", "Other"), r"found 2 \(Other, Still\): name one, as in mine.py:Other"),
        ("1 / 0\n", "can't be loaded: ZeroDivisionError: division by zero\n"),
        ("import nothing_of_that_name\n", "can't be loaded: ModuleNotFoundError: .*nothing_of_that_name"),
        ("def broken(:\n", r"can't be loaded: SyntaxError: .*\(mine.py, line 1\)\n"),
        (
            PLAIN.replace("def step", "def stepp"),
            r"firmware 'mine.py' does not define step; is stepp meant to be step\?",
        ),
        (PLAIN.replace("def step", "def go"), "firmware 'mine.py' does not define step$"),
        (
            PLAIN.replace("    def init", "    Parameters = dict\n    def init"),
            "Parameters must be a pydantic model, as a class derived from mdms.Spec is",
        ),
        (
            PLAIN.replace("    def init", "    from mdms import Spec as parameters\n    def init"),
            "the class of its parameters must be called Parameters, not parameters",
        ),
        (
            PLAIN.replace("    def init", "    message = 3\n    def init"),
            "message must be an np.dtype, not int",
        ),
        (
            PLAIN.replace(
                "    def init", "    import numpy as np\n    message = np.dtype('<f8')\n    def init"
            ),
            "must be structured",
        ),
        (
            PLAIN.replace(
                "    def init", "    import numpy as np\n    message = np.dtype([('a', '>f8')])\n    def init"
            ),
            r"must be little-endian and packed: \[\('a', '<f8'\)\]",
        ),
        (
            PLAIN.replace("    def init", "    def __init__(self, p): raise OSError('no')\n    def init"),
            r"__init__\(\) raised OSError: no",
        ),
    ],
)
def test_a_file_that_holds_no_usable_firmware_is_refused_with_the_reason(
    text: str, message: str, tmp_path: Path
):
    with pytest.raises(FirmwareError, match=message):
        load(CellsSpec(firmware=write(tmp_path, text)), tmp_path)


def test_a_class_that_lacks_a_method_is_refused_by_its_name(tmp_path: Path):
    name = write(tmp_path, PLAIN.replace("def step", "def stepp"))
    with pytest.raises(FirmwareError, match=r"'mine.py:Still' does not define step"):
        find(f"{name}:Still", tmp_path)


def test_a_module_that_lies_here_as_a_file_is_named_by_its_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lying_here").mkdir()
    write(tmp_path / "lying_here", PLAIN)
    with pytest.raises(FirmwareError, match=r"can be given by its path: lying_here/mine.py:Still\)"):
        find("lying_here.mine:Still")
    assert find("lying_here/mine.py:Still").__name__ == "Still"


def problems(firmware: str, parameters: dict[str, Any]) -> list[str]:
    with pytest.raises(ParametersError) as caught:
        load(CellsSpec(firmware=firmware, parameters=parameters))
    return [str(problem) for problem in caught.value.problems]


def test_parameters_of_any_pydantic_model_refuse_what_is_misspelt_unless_they_say_otherwise(tmp_path: Path):
    model = "    class Parameters(__import__('pydantic').BaseModel{allows}):\n        gain: float = 1.0\n"
    strict, open_ = (
        write(tmp_path, PLAIN.replace("    def init", model.format(allows=allows) + "    def init", 1), name)
        for allows, name in (("", "strict.py"), (", extra='allow'", "open.py"))
    )
    assert isinstance(load(CellsSpec(firmware=strict, parameters={"gain": 2.0}), tmp_path), PerCellAdapter)
    with pytest.raises(ParametersError, match="gian: unknown key; did you mean gain"):
        load(CellsSpec(firmware=strict, parameters={"gian": 2.0}), tmp_path)
    assert isinstance(load(CellsSpec(firmware=open_, parameters={"gian": 2.0}), tmp_path), PerCellAdapter)


def test_all_bad_parameters_are_reported_at_once_with_their_paths():
    found = problems(
        "heat_diffusion",
        {"diffusion_number": -0.3, "held": [{"cell": [0, -1], "speed_m_s": [0.0, "x"]}], "hold": []},
    )
    assert found == [
        "held[0].cell[1]: must be greater than or equal to 0, not -1",
        "held[0].speed_m_s[1]: must be a valid number, unable to parse string as a number, not 'x'",
        "diffusion_number: must be greater than 0, not -0.3",
        "hold: unknown key; did you mean held? Known: diffusion_number, held, initial, speed_m_s, ttl_periods",
    ]


def test_paths_inside_fields_are_those_of_the_scene():
    wrong = {"kind": "elliptic", "kx_per_s": -1.0, "ky_pers": -2.0}
    missing, unknown = problems("velocity_field", {"field": {"kind": "sum", "fields": [wrong]}})
    assert missing == "field.fields[0].ky_per_s: is required"
    assert unknown == (
        "field.fields[0].ky_pers: unknown key; did you mean ky_per_s? "
        "Known: centre_m, kind, kx_per_s, ky_per_s"
    )


def test_an_unknown_kind_of_field_is_answered_with_the_known_ones():
    (problem,) = problems("velocity_field", {"field": {"kind": "eliptic"}})
    assert problem.startswith("field: ")
    for kind in ("elliptic", "radial", "squeeze", "sum", "uniform", "vortex"):
        assert f"'{kind}'" in problem


def test_a_missing_field_is_required():
    assert problems("velocity_field", {}) == ["field: is required"]


def test_firmware_without_parameters_takes_none(tmp_path: Path):
    name = write(tmp_path, PLAIN)
    with pytest.raises(ParametersError, match="unknown key; known: none"):
        load(CellsSpec(firmware=name, parameters={"speed": 1}), tmp_path)


def test_where_a_file_could_not_be_loaded_is_shown_in_the_file_and_nowhere_else(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("def late():\n    1 / 0\nlate()\n")
    with pytest.raises(FirmwareError) as caught:
        find("mine.py", tmp_path)
    files = re.findall(r'File "(.*)"', str(caught.value))
    assert files == [str(tmp_path / "mine.py")] * 2


HELPED = """
from __future__ import annotations

from cell_firmware.cell import CellFirmware, CellOutputs
from helper import SPEED


class Helped(CellFirmware):
    def init(self, cell):
        return None

    def step(self, state, inputs):
        import parts.late as late

        return None, CellOutputs((SPEED, late.SPEED))
"""


def helped(folder: Path, speed: float, *, program: str = HELPED) -> Path:
    (folder / "parts").mkdir(parents=True)
    (folder / "helper.py").write_text(f"from parts import late\nSPEED = {speed}\n", encoding="utf-8")
    (folder / "parts" / "__init__.py").write_text("", encoding="utf-8")
    late = f"from .. import helper\nSPEED = {speed} + 0.5\n"
    (folder / "parts" / "late.py").write_text(late, encoding="utf-8")
    (folder / "prog.py").write_text(program, encoding="utf-8")
    return folder / "prog.py"


def drives(firmware: Any) -> tuple[float, float]:
    return firmware.firmware.step(None, None)[1].speed_m_s


def test_a_file_imports_what_lies_beside_it_and_same_names_of_two_folders_do_not_mix(tmp_path: Path) -> None:
    one, other = helped(tmp_path / "one", 1.0), helped(tmp_path / "other", 2.0)
    first, second = load(CellsSpec(firmware=str(one))), load(CellsSpec(firmware=str(other)))
    assert drives(first) == (1.0, 1.5)  # imports within step too, after the other was loaded
    assert drives(second) == (2.0, 2.5)
    assert type(first.firmware).__module__ != type(second.firmware).__module__  # pyright: ignore[reportAttributeAccessIssue]
    assert "helper" not in sys.modules
    assert str(tmp_path / "one") not in sys.path


def test_files_beside_firmware_are_imported_again_with_it(tmp_path: Path) -> None:
    path = helped(tmp_path / "one", 1.0)
    load(CellsSpec(firmware=str(path)))
    (path.parent / "helper.py").write_text("SPEED = 0.125\n", encoding="utf-8")
    assert drives(load(CellsSpec(firmware=str(path))))[0] == 0.125


def test_a_module_beside_comes_before_an_installed_one_for_the_folders_files_alone(tmp_path: Path) -> None:
    program = HELPED.replace(
        "from helper import SPEED", "import random\nimport fractions\nfrom calendar import SPEED"
    )
    path = helped(tmp_path, 1.0, program=program)
    (tmp_path / "calendar.py").write_text("SPEED = 7.0\n", encoding="utf-8")
    (tmp_path / "random.py").write_text("mine = True\n", encoding="utf-8")
    (tmp_path / "cell_firmware.py").write_text("raise RuntimeError('never imported')\n", encoding="utf-8")
    (tmp_path / "fractions").mkdir()  # a folder of data
    firmware = load(CellsSpec(firmware=str(path)))
    assert drives(firmware)[0] == 7.0
    names = type(firmware.firmware).step.__globals__  # pyright: ignore[reportAttributeAccessIssue]
    assert names["random"].mine
    assert names["fractions"].Fraction(1, 2) == 0.5
    import calendar
    import random

    assert calendar.isleap(2000)
    assert random.random() < 1.0


def test_a_failed_import_is_reported_with_the_line_that_imports(tmp_path: Path) -> None:
    path = helped(tmp_path, 1.0)
    (tmp_path / "helper.py").write_text("import nowhere_at_all\n", encoding="utf-8")
    with pytest.raises(FirmwareError) as caught:
        load(CellsSpec(firmware=str(path)))
    text = str(caught.value)
    assert "can't be loaded: ModuleNotFoundError: No module named 'nowhere_at_all'" in text
    assert str(tmp_path / "helper.py") in text
    assert "firmware_files" not in text
    files = [str(getattr(module, "__file__", "")) for module in list(sys.modules.values())]
    assert not [file for file in files if file.startswith(str(tmp_path))]


def test_records_of_a_module_beside_may_be_remembered(tmp_path: Path) -> None:
    program = HELPED.replace("from helper import SPEED", "import helper\nSPEED = 1.0")
    path = helped(tmp_path, 1.0, program=program)
    (tmp_path / "helper.py").write_text(
        "from typing import NamedTuple\nclass Kept(NamedTuple):\n    a: int\n", encoding="utf-8"
    )
    assert "Kept" in [kind.__name__ for kind in records_of(load(CellsSpec(firmware=str(path))))]
