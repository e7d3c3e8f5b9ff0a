"""A refused scene says all that is wrong with it at once, each with path, value and rule."""

from __future__ import annotations

from pathlib import Path

import pytest

import deploy
from deploy.errors import InputError
from deploy.scenes.errors import SceneError
from deploy.scenes.files import load_scene, parse_scene
from deploy.scenes.overrides import Override

GOOD = """
duration_s = 1.0
seed = 1
[array]
rows = 20
columns = 20
missing = [[5, 5]]
[cells]
firmware = "velocity_field"
[cells.parameters]
field = { kind = "elliptic", kx_per_s = -1.0, ky_per_s = -2.0 }
[[parcels]]
size_m = [0.54, 0.32]
mass_kg = 2.0
position_m = [0.0, 0.0]
[friction]
coefficient_s_per_m = 0.2
[[faults]]
kind = "crash"
at_s = 0.5
cell = [3, 4]
[stall]
policy = "coast"
"""

HEAT = """
[cells]
firmware = "heat_diffusion"
[cells.parameters]
held = [{ cell = [0, 0], speed_m_s = [0.1, 0] }, { cell = [99, 0], speed_m_s = [0, 0] }]
"""


def refused(text: str) -> list[str]:
    with pytest.raises(SceneError) as caught:
        parse_scene(text, "x.toml")
    assert caught.value.exit_code == 2
    return str(caught.value).splitlines()


def test_the_scene_these_tests_break_is_good() -> None:
    assert parse_scene(GOOD, "x.toml").ticks == 245


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        # ranges
        ("mass_kg = 2.0", "mass_kg = -2.0", "parcels[0].mass_kg = -2.0: must be > 0"),
        ("mass_kg = 2.0", "mass_kg = 0", "parcels[0].mass_kg = 0: must be > 0"),
        ("mass_kg = 2.0", "mass_kg = inf", "parcels[0].mass_kg = inf: must be finite"),
        ("mass_kg = 2.0", "mass_kg = nan", "parcels[0].mass_kg = nan: must be finite"),
        ("duration_s = 1.0", "duration_s = 0.0", "duration_s = 0.0: must be > 0"),
        ("duration_s = 1.0", "duration_s = 1e10", "duration_s = 10000000000.0: must be <= 1e+09"),
        ("seed = 1", "seed = -1", "seed = -1: must be >= 0"),
        ("at_s = 0.5", "at_s = -0.5", "faults[0].at_s = -0.5: must be >= 0"),
        ("rows = 20", "rows = 0", "array.rows = 0: must be >= 1"),
        ("[stall]", "[solver]\ntolerance = 0\n[stall]", "solver.tolerance = 0: must be >= 1e-14"),
        ("[cells]", "[cells]\nperiod_s = 0", "cells.period_s = 0: must be > 0"),
        # types
        ("mass_kg = 2.0", 'mass_kg = "2"', 'parcels[0].mass_kg = "2": must be a number'),
        ("mass_kg = 2.0", "mass_kg = true", "parcels[0].mass_kg = true: must be a number"),
        ("seed = 1", "seed = 1.5", "seed = 1.5: must be an integer"),
        ("seed = 1", "seed = true", "seed = true: must be an integer"),
        ("seed = 1", "title = 7", "title = 7: must be text in quotes"),
        ("[0.54, 0.32]", "0.5", "parcels[0].size_m = 0.5: must be a list"),
        ("[0.54, 0.32]", "[0.5]", "parcels[0].size_m = [0.5]: must have 2 items, not 1"),
        ("[0.54, 0.32]", "[]", "parcels[0].size_m = []: must have 2 items, not 0"),
        (
            "[[parcels]]",
            "[parcels]",
            "parcels: must be a list: in a file [[parcels]], in double brackets, begins each of its tables",
        ),
        (
            "[0.54, 0.32]",
            "[1, 2, 3]",
            "parcels[0].size_m = [1, 2, 3]: must have at most 2 items, not 3",
        ),
        ("[0.54, 0.32]", "[0.5, -1]", "parcels[0].size_m[1] = -1: must be > 0"),
        (
            "[stall]\n",
            "solver = 3\n[stall]\n",
            "faults[0].solver = 3: unknown key; known: at_s, cell, cells, kind, rectangle, share, until_s, wheels",
        ),
        ("duration_s = 1.0", "duration_s = 1.0\nsolver = 3", "solver = 3: must be a table"),
        # keys
        ("duration_s = 1.0\n", "", "duration_s: required"),
        ("mass_kg = 2.0\n", "", "parcels[0].mass_kg: required"),
        (
            "at_s = 0.5\n",
            "at_s = 0.5\nuntil_s = 0.5\n",
            "faults[0]: until_s must be after at_s, 0.5, not 0.5",
        ),
        ("rows = 20", "rows = 20\npitch = 1", "array.pitch = 1: unknown key; nearest: pitch_m"),
        ("seed = 1", "seed = 1\nparcel = []", "parcel = []: unknown key; nearest: parcels"),
        ("at_s = 0.5", "at_s = 0.5\ncells = []", "faults[0].cells = []: must have at least 1 item, not 0"),
        ("seed = 1", "seed = 1\n[effects]\nmotor = {}", "effects.motor: unknown key; nearest: motors"),
        (
            "seed = 1",
            "seed = 1\n[effects.motors]\ntime_constant = 1",
            "effects.motors.time_constant = 1: unknown key; nearest: time_constant_s",
        ),
        (
            "seed = 1",
            (
                'seed = 1\n[[effects.feeders.feed]]\nname = "w"\nsize_m = [1, 1]\nmass_kg = 0\nposition_m = [0, 0]\n'
                "times_s = [1]"
            ),
            "effects.feeders.feed[0].mass_kg = 0: must be > 0",
        ),
        (
            "seed = 1",
            'seed = 1\n[[effects.feeders.exits]]\nname = "e"\nsize = [1, 1]',
            "effects.feeders.exits[0].size = [1, 1]: unknown key; nearest: size_m",
        ),
        # choices
        ('kind = "crash"', 'kind = "crush"', 'faults[0].kind = "crush": unknown kind; nearest: crash'),
        (
            'kind = "crash"',
            'kind = "crash"\nwheels = "abort"',
            "faults[0].wheels = \"abort\": must be 'coast', 'brake' or 'hold'",
        ),
        (
            'kind = "crash"',
            'kind = "wheel_weak"\nstrength = 1.5',
            "faults[0].strength = 1.5: must be <= 1",
        ),
        ('kind = "crash"', 'kind = "wheel_weak"', "faults[0]: give strength, most_m_s, or both"),
        (
            'kind = "crash"',
            'kind = "wheel_stuck"\nstrength = 1',
            "faults[0].strength = 1: unknown key; known: at_s, cell, cells, kind, rectangle, share, until_s, wheel",
        ),
        (
            'kind = "crash"\nat_s = 0.5',
            'kind = "add"\nat_s = 0',
            "faults[0]: at_s must be > 0: cells that are present from the start need no fault add",
        ),
        (
            'kind = "crash"',
            'kind = "add"\nuntil_s = 1',
            "faults[0]: added cells stay: leave until_s out, and pull them by a fault of kind remove",
        ),
        (
            'kind = "crash"',
            'kind = "wheel_runaway"',
            'faults[0].kind = "wheel_runaway": needs speed_m_s: without effects.motors there is no supply to run at',
        ),
        (
            'kind = "crash"',
            'kind = "remove"\nuntil_s = 0.2',
            "faults[0]: until_s must be after at_s, 0.5, not 0.2",
        ),
        (
            'policy = "coast"',
            'policy = "cost"',
            "stall.policy = \"cost\": must be 'coast', 'brake', 'hold' or 'abort'",
        ),
        # agreement inside a section
        (
            "mass_kg = 2.0",
            "mass_kg = 2.0\nvertices_m = [[0, 0], [1, 0], [0, 1]]",
            "parcels[0]: give size_m or vertices_m, one of the two",
        ),
        ("[[5, 5]]", "[[5, 50]]", "array: missing has [5, 50]: the array has columns 0..19"),
        # agreement between sections
        ("[3, 4]", "[7, 99]", "faults[0].cell = [7, 99]: the array has columns 0..19"),
        ("[3, 4]", "[20, 0]", "faults[0].cell = [20, 0]: the array has rows 0..19"),
        ("[3, 4]", "[5, 5]", "faults[0].cell = [5, 5]: the array has no cell there"),
        (
            "[cells]",
            "[cells.speed_loop]\n[cells]",
            "cells.speed_loop: needs effects.motors: the speed loop controls motors",
        ),
        (
            "seed = 1",
            "seed = 1\n[effects.encoder]",
            "effects.motors: must be set too: effects.encoder needs it",
        ),
        (
            "seed = 1",
            "seed = 1\n[effects]\nmotors = {}\nencoder = { counts_per_revolution = 9000 }",
            (
                "effects.encoder.counts_per_revolution = 9000: at most 127 counts a period can be distinguished, and a "
                "wheel without load makes 234.7 at supply_v"
            ),
        ),
        (
            "seed = 1",
            "seed = 1\n[effects]\nmotors = {}\nfixed_point = {}\n[cells.speed_loop]\nki_v_per_m = 1e-9",
            "cells.speed_loop.ki_v_per_m = 1e-09: fixed point: so small that it rounds to nothing",
        ),
        (
            "seed = 1",
            "seed = 1\n[effects]\nmotors = {}\npwm = { levels = 255, frequency_hz = 7800.0 }",
            "effects.pwm: give levels or frequency_hz, not both",
        ),
        (
            "coefficient_s_per_m = 0.2",
            'law = "coulomb"\ncoefficient = 0.2',
            (
                'solver.name = "exact": solves law viscous, coulomb_sliding, rolling, stick_slip, not coulomb; '
                "use implicit"
            ),
        ),
        (
            "coefficient_s_per_m = 0.2",
            'law = "culomb"',
            'friction.law = "culomb": unknown law; nearest: coulomb',
        ),
        ("coefficient_s_per_m = 0.2", 'law = "coulomb"', "friction.coefficient: required"),
        (
            "coefficient_s_per_m = 0.2",
            "coefficient = 0.2\ncoefficient_s_per_m = 0.2",
            "friction.coefficient = 0.2: unknown key; nearest: coefficient_s_per_m",
        ),
        # initial values
        (
            'firmware = "velocity_field"',
            'firmware = "velocity_field"\ninitial_registers = { speed_m_s = { "3,4" = [0, 0], "20,3" = [0, 1] } }',
            'cells.initial_registers.speed_m_s.20,3 = [0, 1]: must be of a cell of the array, such as "3,4"',
        ),
        # the firmware's own
        (
            '"elliptic"',
            '"eliptic"',
            'cells.parameters.field.kind = "eliptic": unknown kind; nearest: elliptic',
        ),
        ('kind = "elliptic", ', "", "cells.parameters.field.kind: required"),
        ("kx_per_s = -1.0, ", "", "cells.parameters.field.kx_per_s: required"),
        (
            "kx_per_s = -1.0",
            'kx_per_s = "a"',
            'cells.parameters.field.kx_per_s = "a": must be a number',
        ),
        (
            "kx_per_s = -1.0",
            "kx_per_s = -1.0, kz_per_s = 1",
            "cells.parameters.field.kz_per_s = 1: unknown key; nearest: ky_per_s",
        ),
        ("field =", "feld = 1\nfield =", "cells.parameters.feld = 1: unknown key; nearest: field"),
    ],
)
def test_a_wrong_value_is_named_with_its_path_value_and_rule(old: str, new: str, line: str) -> None:
    assert GOOD.count(old) >= 1
    assert refused(GOOD.replace(old, new, 1)) == [f"scene x.toml: {line}"]


def test_effects_that_exclude_each_other_are_named() -> None:
    effects = (
        "[effects]\nroller_impacts = { spacing_m = 0.01, impulse_s = 0.001 }\n"
        "load_transfer = { centre_of_mass_height_m = 0.1 }"
    )
    assert "scene x.toml: effects.load_transfer: doesn't go with effects.roller_impacts" in refused(
        GOOD.replace("seed = 1", f"seed = 1\n{effects}", 1)
    )


def test_a_union_kind_nested_in_a_sum_is_found_at_its_place() -> None:
    field = '{ kind = "sum", fields = [{ kind = "uniform", velocity_m_s = [0, 0] }, { kind = "vorteks" }] }'
    text = GOOD.replace('{ kind = "elliptic", kx_per_s = -1.0, ky_per_s = -2.0 }', field)
    assert refused(text) == [
        'scene x.toml: cells.parameters.field.fields[1].kind = "vorteks": unknown kind; nearest: vortex'
    ]


def test_an_unknown_key_is_answered_with_the_keys_of_the_kind_that_was_chosen() -> None:
    field = '{ kind = "uniform", velocity_m_s = [0, 0], centre = [0, 0] }'
    text = GOOD.replace('{ kind = "elliptic", kx_per_s = -1.0, ky_per_s = -2.0 }', field)
    assert refused(text) == [
        "scene x.toml: cells.parameters.field.centre = [0, 0]: unknown key; known: kind, velocity_m_s"
    ]


def test_firmware_checks_its_parameters_against_the_array() -> None:
    head, tail = GOOD.partition("[cells]")[0], GOOD.partition("[[parcels]]")[2]
    (line,) = refused(head + HEAT + "[[parcels]]" + tail)
    assert line == "scene x.toml: cells.parameters.held[1].cell = [99, 0]: the array has no cell [99, 0]"


def test_a_field_that_is_no_number_at_a_cell_is_refused_with_the_cell() -> None:
    text = GOOD.replace(
        '"elliptic", kx_per_s = -1.0, ky_per_s = -2.0', '"expression", vx = "sqrt(0.9 - x)", vy = "0"'
    )
    (line,) = refused(text)
    assert line.startswith('scene x.toml: cells.parameters.field = {kind = "expression", ')
    assert line.endswith(
        ": is (nan, 0) m/s at cell [0, 19], x = 0.95, y = -0.95, and at 19 more: must be finite"
    )


def test_a_formula_that_is_refused_is_shown_with_the_column() -> None:
    text = GOOD.replace('"elliptic", kx_per_s = -1.0, ky_per_s = -2.0', '"expression", vx = "2*z", vy = "0"')
    assert refused(text) == [
        "scene x.toml: cells.parameters.field.vx = \"2*z\": column 3: unknown name 'z'; known: x, y, pi",
        "  2*z",
        "    ^",
    ]


def test_unknown_firmware_is_answered_with_the_nearest_bundled_one() -> None:
    (line,) = refused(GOOD.replace('"velocity_field"', '"velocity_feld"'))
    assert line.startswith("scene x.toml: cells.firmware: unknown firmware 'velocity_feld'")
    assert "'velocity_field'" in line


def test_all_errors_of_a_file_come_at_once_across_sections_and_kinds() -> None:
    text = (
        GOOD.replace("duration_s = 1.0", "duration_s = -1.0")
        .replace("mass_kg = 2.0", "mass = 2.0")
        .replace("[3, 4]", "[7, 99]")
        .replace("ky_per_s = -2.0", "ky_per_s = nan")
        .replace('policy = "coast"', 'polcy = "coast"')
    )
    assert refused(text) == [
        "scene x.toml: duration_s = -1.0: must be > 0",
        "scene x.toml: parcels[0].mass_kg: required",
        "scene x.toml: parcels[0].mass = 2.0: unknown key; nearest: mass_kg",
        'scene x.toml: stall.polcy = "coast": unknown key; nearest: policy',
        "scene x.toml: faults[0].cell = [7, 99]: the array has columns 0..19",
        "scene x.toml: cells.parameters.field.ky_per_s = nan: must be finite",
    ]


def test_what_depends_on_an_invalid_section_is_not_guessed_at() -> None:
    text = GOOD.replace("rows = 20", "rows = -1").replace("[3, 4]", "[7, 99]")
    assert refused(text) == ["scene x.toml: array.rows = -1: must be >= 1"]


def test_only_the_valid_faults_are_checked_against_the_array_and_keep_their_numbers() -> None:
    text = GOOD.replace("[stall]", '[[faults]]\nkind = "crash"\nat_s = 1\ncell = [0, 99]\n[stall]').replace(
        "at_s = 0.5", "at_s = -1"
    )
    assert refused(text) == [
        "scene x.toml: faults[0].at_s = -1: must be >= 0",
        "scene x.toml: faults[1].cell = [0, 99]: the array has columns 0..19",
    ]


def test_a_long_value_is_cut() -> None:
    (line,) = refused(GOOD.replace("[0.54, 0.32]", str(list(range(100)))))
    assert line.endswith("...: must have at most 2 items, not 100")
    assert len(line) < 150


def test_broken_toml_is_refused_with_its_line() -> None:
    with pytest.raises(InputError, match=r"^scene x\.toml: not TOML: .*\(at line 3, column 7\)$"):
        parse_scene("seed = 1\nduration_s = 1.0\nrows  20", "x.toml")


def test_an_unknown_name_is_answered_with_the_nearest_bundled_scene() -> None:
    with pytest.raises(
        InputError, match=r"^scene eliptic: neither a bundled scene nor a file; nearest: elliptic"
    ):
        load_scene("eliptic")


def test_a_name_like_none_is_answered_with_all_bundled_scenes() -> None:
    known = sorted(path.stem for path in (Path(deploy.__path__[0]) / "scenes").glob("*.toml"))
    with pytest.raises(InputError, match=f"known: {', '.join(known)} "):
        load_scene("zzzz")


def test_a_missing_file_is_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"none\.toml: cannot be read: No such file or directory"):
        load_scene(str(tmp_path / "none.toml"))


def test_a_folder_is_no_scene(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="cannot be read: Is a directory"):
        load_scene(str(tmp_path))


def test_a_file_that_is_no_text_is_refused(tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_bytes(b"a = '\xff'")
    with pytest.raises(InputError, match="must be UTF-8 text; byte 5 is not"):
        load_scene(str(tmp_path / "x.toml"))


def test_a_file_named_like_a_bundled_scene_is_reached_by_its_path(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "elliptic").write_text(GOOD)
    monkeypatch.chdir(tmp_path)
    assert load_scene("./elliptic").duration_s == 1.0
    assert load_scene("elliptic").duration_s == 10.0


def test_a_firmware_file_is_searched_beside_its_scene(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "import numpy as np\n"
        "from cell_firmware.firmware import Firmware, Outputs\n"
        "class Still(Firmware):\n"
        "    def init(self, cells):\n"
        "        return {'n': np.zeros((len(cells), 1))}\n"
        "    def step(self, state, inputs):\n"
        "        return state, Outputs(np.zeros((len(state['n']), 2)))\n"
    )
    text = GOOD.replace('"velocity_field"', '"mine.py:Still"').replace("field = {", "# field = {")
    (tmp_path / "x.toml").write_text(text)
    scene = load_scene(str(tmp_path / "x.toml"))
    assert scene.cells.firmware == f"{tmp_path}/mine.py:Still"
    assert str(tmp_path) not in scene.canonical().decode()

    (tmp_path / "x.toml").write_text(text.replace("mine.py", "yours.py"))
    with pytest.raises(SceneError, match=r"cells\.firmware: .*there is no file"):
        load_scene(str(tmp_path / "x.toml"))


def test_a_byte_order_mark_is_no_part_of_a_scene(tmp_path: Path) -> None:
    (tmp_path / "x.toml").write_text(GOOD, encoding="utf-8-sig")
    assert load_scene(str(tmp_path / "x.toml")).ticks == 245


def test_a_traceback_of_a_firmware_s_file_comes_below_the_line_that_names_the_option(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text("1 / 0\n")
    with pytest.raises(SceneError) as caught:
        load_scene("elliptic", [Override.parse(f"cells.firmware={tmp_path}/mine.py")])
    first, *more = str(caught.value).splitlines()
    assert first.startswith("scene elliptic: cells.firmware: firmware ")
    assert first.endswith(
        f"ZeroDivisionError: division by zero (from --set cells.firmware={tmp_path}/mine.py)"
    )
    assert more[-1] == "ZeroDivisionError: division by zero"
