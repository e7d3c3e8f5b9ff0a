"""The ladder of fidelity: each rung is what is below and one thing more."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from deploy.commands.options import load_scene
from deploy.errors import InputError
from deploy.scenes.scene import Scene
from deploy.studies.effects import ladder as ladder_module
from deploy.studies.effects.ablation import effect_types, tables
from deploy.studies.effects.ladder import RungResult, run_ladder, rungs
from deploy.studies.effects.plot import draw_ladder
from deploy.studies.effects.run import TracedRun, run_variant
from deploy.studies.effects.sensitivity import Sensitivity, compare
from deploy.util.formatting import silent
from plant.effects.contact_width import ContactWidthSpec
from plant.effects.roller_impacts import RollerImpactsSpec
from plant.effects.wheel_load import WheelLoadSpec

BASE = ["quasi_static", "viscous", "stick_slip"]


def test_every_effect_with_a_place_is_a_rung_in_that_order() -> None:
    placed = [name for name, kind in effect_types().items() if kind.fidelity_rank is not None]
    assert [rung.name for rung in rungs(load_scene("ladder"))] == BASE + placed


def test_each_rung_has_all_below_it_and_one_effect_more() -> None:
    below: set[str] = set()
    solvers = [rung.scene.solver.name for rung in rungs(load_scene("ladder")) if rung.scene is not None]
    assert solvers == ["quasi_static", *["implicit"] * (len(solvers) - 1)]
    for rung in rungs(load_scene("ladder")):
        assert rung.scene is not None
        there = set(tables(rung.scene))
        assert there - below == (set() if rung.name in BASE else {rung.name})
        assert below - there == set(rung.instead)
        below = below if rung.instead else there


def test_an_effect_that_doesn_t_go_with_one_below_stands_beside_the_ladder(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(RollerImpactsSpec, "excludes", ("motors",))
    monkeypatch.setattr(WheelLoadSpec, "excludes", ())
    found = {rung.name: rung for rung in rungs(load_scene("ladder"))}
    beside, above = found["roller_impacts"], found["sensor"]
    assert set(beside.instead) == {"motors"} | {
        name for name, kind in effect_types().items() if "motors" in kind.needs
    }
    assert beside.scene is not None
    assert beside.scene.friction.law == "stick_slip"
    assert beside.words.endswith(f"; in place of {', '.join(beside.instead)}")
    assert above.scene is not None
    assert {"motors", "wheel_load"} <= tables(above.scene).keys()
    assert "roller_impacts" not in tables(above.scene)


def test_the_top_is_never_a_rung_beside_the_ladder() -> None:
    low, top, beside = rungs(load_scene("ladder", duration=0.1))[:3]
    climbed = run_ladder([low, top, replace(beside, instead=("motors",))], 1, lambda line: None)
    assert [one.distance is not None and one.distance.none for one in climbed] == [False, True, False]


def test_motors_take_over_from_the_law_that_has_its_own() -> None:
    laws = {
        rung.name: rung.scene.friction.law for rung in rungs(load_scene("ladder")) if rung.scene is not None
    }
    assert laws["stick_slip"] == laws["uneven_supports"] == "stick_slip"
    assert laws["motors"] == laws["wheel_load"] == "coulomb"


def test_a_rung_has_the_scene_s_own_settings_and_what_has_no_place_stays() -> None:
    found = {rung.name: rung for rung in rungs(load_scene("uneven"))}
    (own,) = (rung.scene for rung in found.values() if rung.name == "uneven_supports")
    assert own is not None
    assert own.effects.uneven_supports == load_scene("uneven").effects.uneven_supports
    railed = rungs(load_scene("rails"))
    assert all("parcel_contact" in tables(rung.scene) for rung in railed if rung.scene is not None)
    assert railed[0].scene is None
    assert railed[0].reason.startswith("solver.name: leaves out effects.parcel_contact")
    (tall,) = (rung for rung in railed if rung.name == "load_transfer")
    assert tall.scene is None
    assert tall.reason.startswith("effects.load_transfer: doesn't go with effects.parcel_contact")


def test_an_effect_s_declared_place_is_where_it_stands(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ContactWidthSpec, "fidelity_rank", 5)
    assert [rung.name for rung in rungs(load_scene("ladder"))][3] == "contact_width"


def test_distances_are_from_the_last_rung_that_came_to_its_end() -> None:
    ladder = rungs(load_scene("ladder", duration=0.3))
    refused = replace(ladder[0], name="refused", scene=None, reason="it doesn't fit")
    climbed = run_ladder([*ladder[:3], refused], 1, lambda line: None)
    assert climbed[3].distance is None
    assert climbed[3].reason == refused.reason
    top, quasi = climbed[2], climbed[0]
    assert top.distance is not None
    assert top.distance.none
    scenes = [rung.scene for rung in ladder[:3]]
    assert scenes[0] is not None
    assert scenes[2] is not None
    wanted = compare(*(run_variant(scene, cells=True, notify=silent) for scene in (scenes[0], scenes[2])))
    assert quasi.distance == wanted
    assert wanted.displacement_m is not None
    assert wanted.displacement_m > 1e-4
    assert all(one.wall_s is not None and one.wall_s > 0.0 for one in climbed[:3])


def test_a_rung_that_blows_up_is_left_out_with_the_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def followed(scene: Scene, *, cells: bool, notify: Callable[[str], None]) -> TracedRun:
        if scene.friction.law == "stick_slip":
            raise InputError("it doesn't stand")
        run = run_variant(scene, cells=cells, notify=notify)
        if scene.solver.name == "quasi_static":
            run.result.end("unstable", "it blew up")
        return run

    monkeypatch.setattr(ladder_module, "run_variant", followed)
    climbed = run_ladder(rungs(load_scene("ladder", duration=0.05))[:3], 1, lambda line: None)
    assert [one.reason for one in climbed] == ["it blew up", "", "it doesn't stand"]
    assert [one.distance is None for one in climbed] == [True, False, True]


def _at(metres: float) -> Sensitivity:
    return Sensitivity(
        displacement_m=metres,
        turn_rad=0.0,
        end_m=metres,
        end_rad=0.0,
        parcels=0,
        settled_s=(None, None),
        events=0,
        moved=None,
        only=(0, 0),
    )


@pytest.mark.parametrize("distances", [(0.1, 1e-3, 0.0), (0.0,), ()])
def test_a_ladder_of_any_height_is_drawn(tmp_path: Path, distances: tuple[float, ...]) -> None:
    scene = load_scene("ladder")
    ladder = rungs(scene)
    climbed = [
        RungResult(rung, [0.1 * (n + 1), 0.12 * (n + 1)], _at(d))
        for n, (rung, d) in enumerate(zip(ladder, distances, strict=False))
    ]
    climbed += [RungResult(rung, reason="left out") for rung in ladder[len(distances) :]]
    draw_ladder(scene, climbed, tmp_path / "ladder.png")
    assert (tmp_path / "ladder.png").read_bytes().startswith(b"\x89PNG")
