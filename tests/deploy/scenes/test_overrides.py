"""``--set`` reaches any value of a scene and is validated like the file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from deploy.commands.options import load_scene
from deploy.errors import InputError
from deploy.scenes.errors import SceneError
from deploy.scenes.files import scene_text
from deploy.scenes.overrides import Override, apply


def overridden(*texts: str) -> dict[str, Any]:
    data: dict[str, Any] = {"seed": 1, "array": {"rows": 2}, "parcels": [{"mass_kg": 1.0}, {"mass_kg": 2.0}]}
    apply(data, [Override.parse(text) for text in texts])
    return data


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("1", 1),
        ("-2.5e-3", -2.5e-3),
        ("true", True),
        ('"a b"', "a b"),
        ("'a'", "a"),
        ("[0.5, 0.3]", [0.5, 0.3]),
        ('{ kind = "vortex" }', {"kind": "vortex"}),
        ("heat_diffusion", "heat_diffusion"),
        ("my.module:Class", "my.module:Class"),
        ("./folder/my-cell.py:Class", "./folder/my-cell.py:Class"),
        ("", None),
        ("[1, 2", None),
        ("two words", None),
        ("1 # comment\nx = 2", None),
        ("7a", None),
    ],
)
def test_a_value_is_toml_or_a_bare_word_or_refused(text: str, value: Any) -> None:
    if value is None:
        with pytest.raises(InputError, match=r"^--set key="):
            Override.parse(f"key={text}")
    else:
        assert Override.parse(f"key={text}").value == value


def test_a_list_item_may_be_numbered_as_errors_number_it() -> None:
    assert overridden("parcels[1].mass_kg=3.5")["parcels"] == [{"mass_kg": 1.0}, {"mass_kg": 3.5}]
    assert overridden("a[0][0]=1")["a"] == [[1]]


@given(
    st.recursive(
        st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False),
        lambda items: st.lists(items, max_size=4),
        max_leaves=8,
    )
)
def test_any_toml_number_or_list_arrives_as_it_was_written(value: Any) -> None:
    text = str(value).replace("True", "true").replace("False", "false")
    assert Override.parse(f"a.b={text}").value == value


def test_spaces_around_key_and_value_do_not_matter() -> None:
    override = Override.parse(" array.rows = 3 ")
    assert (override.path, override.value) == (("array", "rows"), 3)


@pytest.mark.parametrize(
    "text", ["seed", "=1", ".seed=1", "a..b=1", "a b=1", "parcels[0=1", "[0]=1", "parcels[-1]=1", ""]
)
def test_a_malformed_option_is_refused_by_name(text: str) -> None:
    with pytest.raises(InputError, match=r"^--set .*: (must be KEY=VALUE|the key must be)"):
        Override.parse(text)


def test_a_value_in_a_table_is_changed_and_the_others_stay() -> None:
    assert overridden("parcels.1.mass_kg=3.5")["parcels"] == [{"mass_kg": 1.0}, {"mass_kg": 3.5}]


def test_tables_and_lists_that_are_not_there_are_made() -> None:
    data = overridden("effects.motors.time_constant_s=0.05", "faults.0.cell=[1, 2]", "faults.0.at_s=1.0")
    assert data["effects"] == {"motors": {"time_constant_s": 0.05}}
    assert data["faults"] == [{"cell": [1, 2], "at_s": 1.0}]


def test_the_number_after_the_last_adds_an_item() -> None:
    assert overridden("parcels.2.mass_kg=9")["parcels"][2] == {"mass_kg": 9}
    assert overridden("parcels.2={ mass_kg = 9 }")["parcels"][2] == {"mass_kg": 9}


def test_the_last_of_several_wins() -> None:
    assert overridden("seed=2", "seed=3")["seed"] == 3
    assert overridden("array.rows=5", "array={ columns = 1 }")["array"] == {"columns": 1}


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("parcels.3.mass_kg=1", "parcels has 2 items: the number must be 0..2 (2 adds one)"),
        ("parcels.first=1", "parcels is a list: its items are numbered 0..1"),
        ("seed.x=1", "seed = 1: has nothing inside it to set"),
        ("parcels.0.mass_kg.0=1", "parcels[0].mass_kg = 1.0: has nothing inside it to set"),
    ],
)
def test_a_path_that_leads_nowhere_is_refused(text: str, message: str) -> None:
    with pytest.raises(InputError) as caught:
        overridden(text)
    assert str(caught.value) == f"--set {text}: {message}"


def test_an_option_that_makes_a_scene_invalid_is_named() -> None:
    with pytest.raises(SceneError) as caught:
        load_scene("elliptic", ["parcels.0.mass_kg=-2.0", "array.pich_m=1"], duration=-1.0, tolerance=0.0)
    assert str(caught.value).splitlines() == [
        "scene elliptic: duration_s = -1.0: must be > 0 (from --duration -1.0)",
        "scene elliptic: array.pich_m = 1: unknown key; nearest: pitch_m (from --set array.pich_m=1)",
        "scene elliptic: parcels[0].mass_kg = -2.0: must be > 0 (from --set parcels.0.mass_kg=-2.0)",
        "scene elliptic: solver.tolerance = 0.0: must be >= 1e-14 (from --tolerance 0.0)",
    ]


def test_an_option_is_named_for_what_it_breaks_elsewhere_in_its_table() -> None:
    with pytest.raises(
        SceneError, match=r"field\.velocity_m_s: required \(from --set cells\.parameters\.field="
    ):
        load_scene("elliptic", ['cells.parameters.field={ kind = "uniform" }'])


def test_shorthand_options_win_over_the_file_and_over_set() -> None:
    scene = load_scene(
        "elliptic", ["seed=5", "solver.tolerance=1e-3"], seed=7, duration=0.5, solver="exact", tolerance=1e-12
    )
    assert (scene.seed, scene.duration_s, scene.solver.tolerance) == (7, 0.5, 1e-12)


def test_an_unknown_solver_is_refused_by_its_option() -> None:
    with pytest.raises(
        SceneError, match=r"solver\.name = \"exakt\": unknown name; nearest: exact \(from --solver exakt\)"
    ):
        load_scene("elliptic", solver="exakt")


def test_motors_can_be_added_to_any_scene() -> None:
    scene = load_scene("elliptic", ["effects.motors.time_constant_s=0.05"])
    assert scene.effects.motors is not None
    assert scene.effects.motors.time_constant_s == 0.05
    assert scene.speed_loop is not None


def test_another_solver_keeps_of_the_file_s_settings_those_it_has() -> None:
    assert load_scene("elliptic", solver="implicit").solver.accuracy() == {
        "name": "implicit",
        "tolerance": 1e-9,
    }
    stepped = load_scene("elliptic", solver="fixed_step", step=2e-3)
    assert stepped.solver.accuracy() == {"name": "fixed_step", "method": "rk4", "step_s": 2e-3}
    chosen = load_scene("elliptic", ["solver.name=scipy", "solver.method=LSODA"])
    assert chosen.solver.accuracy() == {"name": "scipy", "method": "LSODA", "tolerance": 1e-9}


@pytest.mark.parametrize(
    ("options", "line"),
    [
        (
            {"step": 1e-3},
            "solver.step_s = 0.001: unknown key; known: capture_m, max_steps_per_s, name, tolerance (from --step",
        ),
        (
            {"solver": "fixed_step", "tolerance": 1e-6},
            "solver.tolerance = 1e-06: unknown key; known: method, name, step_s (from --tolerance 1e-06)",
        ),
        (
            {"solver": "fixed_step", "step": 0.0},
            "solver.step_s = 0.0: must be >= 1e-09 (from --step 0.0)",
        ),
        (
            {"solver": "scipy", "sets": ["friction={ law = 'coulomb', coefficient = 0.3 }"]},
            'solver.name = "scipy": solves law viscous, coulomb_sliding, rolling, stick_slip, not coulomb; use',
        ),
    ],
)
def test_a_setting_that_is_not_the_solver_s_is_refused_by_its_option(
    options: dict[str, Any], line: str
) -> None:
    with pytest.raises(SceneError) as caught:
        load_scene("elliptic", **options)
    assert str(caught.value).startswith(f"scene elliptic: {line}")
    assert str(caught.value).count("\n") == 0


def test_a_misspelt_setting_of_the_file_is_refused_whatever_solver_is_requested(tmp_path: Path) -> None:
    scene = tmp_path / "x.toml"
    scene.write_text(scene_text("elliptic").replace("tolerance", "tolerence"))
    with pytest.raises(SceneError, match=r"solver\.tolerence = 1e-09: unknown key; nearest: tolerance"):
        load_scene(str(scene), solver="implicit")
