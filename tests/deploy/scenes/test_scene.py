"""A scene composes its sections and describes itself the same way however it was written."""

from __future__ import annotations

import json
import tomllib

import numpy as np
import pytest
from pydantic import ValidationError

from deploy.scenes.files import bundled_names, load_scene, parse_scene, scene_text
from deploy.scenes.scene import Scene
from plant.specs import PlantSpec

SHORT = """
duration_s = 1.0
array = { rows = 2, columns = 3 }
cells = { parameters = { field = { kind = "uniform", velocity_m_s = [0.1, 0.0] } } }
friction = { coefficient_s_per_m = 0.2 }
"""


def test_the_bundled_elliptic_scene_says_what_the_documentation_says() -> None:
    scene = load_scene("elliptic")
    assert (scene.name, scene.duration_s, scene.seed) == ("elliptic", 10.0, 1)
    assert (scene.array.rows, scene.array.columns, scene.array.pitch_m) == (20, 20, 0.1)
    assert scene.cells.parameters["field"] == {"kind": "elliptic", "kx_per_s": -1.0, "ky_per_s": -2.0}
    parcel = scene.parcels[0]
    assert (parcel.size_m, parcel.mass_kg) == ((0.54, 0.32), 2.0)
    assert (parcel.position_m, parcel.angle_rad) == ((0.55, 0.5), 0.9)
    assert (scene.friction.coefficient_s_per_m, scene.solver.tolerance) == (0.2, 1e-9)


def test_a_dict_may_hold_numbers_and_arrays_of_numpy() -> None:
    tables = tomllib.loads(SHORT)
    plain = load_scene(tables)
    tables["duration_s"] = np.float64(1.0)
    tables["array"] = {"rows": np.int64(2), "columns": np.uint8(3)}
    tables["cells"]["parameters"]["field"]["velocity_m_s"] = np.array([0.1, 0.0])
    assert load_scene(tables) == plain
    assert isinstance(tables["array"]["rows"], np.int64)  # the caller's dict is left as it is


def test_the_prototype_has_eighteen_cells_with_cell_0_0_among_them_and_motors() -> None:
    scene = load_scene("prototype")
    assert len(scene.lattice()) == 18
    assert (0, 0) in scene.lattice()
    assert scene.effects.motors is not None
    assert scene.speed_loop is not None


def test_the_plant_gets_its_sections_and_no_others() -> None:
    scene = load_scene("motors")
    spec = scene.plant_spec()
    assert isinstance(spec, PlantSpec)
    assert spec.parcels == scene.parcels
    assert dict(spec.effects.enabled()) == dict(scene.effects.enabled())
    assert spec.gravity_m_s2 == scene.gravity_m_s2


def test_the_last_tick_may_be_shorter_than_a_period() -> None:
    def scene(duration_s: float, period_s: float) -> Scene:
        return parse_scene(
            SHORT.replace("duration_s = 1.0", f"duration_s = {duration_s}").replace(
                "cells = {", f"cells = {{ period_s = {period_s},"
            ),
            "short",
        )

    assert scene(1.0, 0.25).ticks == 4
    assert scene(1.0, 0.3).ticks == 4
    assert scene(0.3, 0.1).ticks == 3
    assert scene(0.1, 1.0).ticks == 1
    assert scene(0.3, 0.1).duration_ns == 300_000_000


def test_a_scheduled_time_acts_at_the_first_tick_that_does_not_begin_before_it() -> None:
    scene = load_scene("elliptic")
    assert scene.cells.period_ns == 4_096_000
    assert scene.tick_at(0.0) == 0
    assert scene.tick_at(0.004096) == 1
    assert scene.tick_at(0.0040961) == 2
    assert scene.tick_at(1e-12) == 1
    assert scene.tick_at(0.3 * 0.004096) == 1


def test_motors_bring_the_default_speed_loop() -> None:
    scene = parse_scene(SHORT + "effects = { motors = {} }", "short")
    assert scene.cells.speed_loop is None
    assert scene.speed_loop is not None
    assert parse_scene(SHORT, "short").speed_loop is None


def test_a_scene_made_in_python_is_checked_like_a_file() -> None:
    data = tomllib.loads(SHORT) | {"faults": [{"kind": "crash", "at_s": 1.0, "cell": [9, 0]}]}
    with pytest.raises(ValidationError, match=r"faults\.0\.cell\n  the array has rows 0\.\.1"):
        Scene.model_validate(data)


def test_a_scene_cannot_be_changed() -> None:
    with pytest.raises(ValidationError, match="frozen"):
        load_scene("elliptic").duration_s = 2.0  # pyright: ignore[reportAttributeAccessIssue]


# --- the canonical description ----------------------------------------------------------------------


@pytest.mark.parametrize("name", bundled_names())
def test_the_canonical_description_survives_being_written_out_in_full(name: str) -> None:
    scene = load_scene(name)
    full = Scene.model_validate_json(scene.model_dump_json())
    assert full.canonical() == scene.canonical()


def test_the_canonical_description_does_not_depend_on_how_the_file_is_written() -> None:
    other = """
        title = "Other words"
        friction.coefficient_s_per_m = 2e-1
        friction.law = "viscous"   # the default
        seed = 0
        faults = []
        duration_s = 1
        [cells.parameters.field]
        velocity_m_s = [0.10, 0]
        kind = "uniform"
        [array]
        columns = 3
        pitch_m = 0.1
        rows = 2
        [stall]
        deadline_s = 60
        lease_s = 10
    """
    assert parse_scene(other, "other").canonical() == parse_scene(SHORT, "short").canonical()


def test_the_order_in_which_cells_are_listed_does_not_matter() -> None:
    def canonical(cells: str) -> bytes:
        return parse_scene(SHORT.replace("columns = 3", f"columns = 3, cells = {cells}"), "short").canonical()

    assert canonical("[[0, 0], [1, 2]]") == canonical("[[1, 2], [0, 0]]")


def test_defaults_of_the_firmware_are_part_of_the_canonical_description() -> None:
    centred = SHORT.replace('"uniform", velocity_m_s = [0.1, 0.0]', '"vortex", rate_rad_s = 1.0')
    written = centred.replace("rate_rad_s = 1.0", "rate_rad_s = 1.0, centre_m = [0, 0]")
    moved = centred.replace("rate_rad_s = 1.0", "rate_rad_s = 1.0, centre_m = [0, 1]")
    described = [parse_scene(text, "short").canonical() for text in (centred, written, moved)]
    assert described[0] == described[1]
    assert described[0] != described[2]


def test_the_default_speed_loop_is_the_same_whether_or_not_it_is_written() -> None:
    motors = SHORT + "effects = { motors = {} }"
    written = motors.replace("cells = {", "cells = { speed_loop = {}, ")
    changed = motors.replace("cells = {", "cells = { speed_loop = { kp_v_per_m_s = 1 }, ")
    described = [parse_scene(text, "short").canonical() for text in (motors, written, changed)]
    assert described[0] == described[1]
    assert described[0] != described[2]


@pytest.mark.parametrize(
    "change",
    [
        "seed=7",
        "duration_s=2.0",
        "gravity_m_s2=9.8",
        "array.pitch_m=0.2",
        "array.missing=[[0, 0]]",
        "cells.period_s=0.01",
        "cells.parameters.field.kx_per_s=-1.5",
        "parcels.0.mass_kg=2.5",
        "friction.coefficient_s_per_m=0.3",
        "effects.motors={}",
        "solver.tolerance=1e-10",
        "stall.policy=hold",
    ],
)
def test_whatever_changes_the_motion_changes_the_canonical_description(change: str) -> None:
    from deploy.commands.options import load_scene as with_options

    assert with_options("elliptic", [change]).canonical() != load_scene("elliptic").canonical()


def test_the_canonical_description_is_sorted_json() -> None:
    text = load_scene("heat").canonical().decode()
    data = json.loads(text)
    assert text == json.dumps(data, sort_keys=True, separators=(",", ":"))
    assert "title" not in data


def test_printing_a_bundled_scene_gives_a_scene_file() -> None:
    for name in bundled_names():
        assert parse_scene(scene_text(name), "copy.toml").canonical() == load_scene(name).canonical()
