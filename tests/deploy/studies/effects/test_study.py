"""Influence is honest: nothing where an effect does nothing, far above the solver's error where it counts."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from deploy.commands.options import load_scene
from deploy.errors import InputError
from deploy.runs.headless import needs_cells
from deploy.scenes.errors import SceneError
from deploy.scenes.files import bundled_names
from deploy.scenes.scene import Scene
from deploy.studies.effects import study as study_module
from deploy.studies.effects.ablation import VariantRejected, ablate, effect_types, refined, tables, variant
from deploy.studies.effects.run import TracedRun, compilation_announced, run_variant
from deploy.studies.effects.sensitivity import compare
from deploy.studies.effects.study import Cost, EffectStudy
from deploy.util.formatting import silent

SHOWN = {
    "uneven_supports": ("uneven", 1.5),
    "contact_width": ("wide_wheels", 1.5),
    "uneven_friction": ("worn", 1.5),
    "roller_drag": ("dragging", 1.5),
    "load_transfer": ("tall", 1.5),
    "motors": ("motors", 0.5),
    "wheel_load": ("loaded", 0.4),
    "roller_impacts": ("bumpy", 0.5),
    "clock": ("drifting", 0.5),
    "analogue_sensors": ("spots", 1.0),
    "adc": ("spots", 1.0),
    "sensor": ("noisy", 0.5),
    "link_delay": ("noisy", 0.5),
    "link_loss": ("noisy", 0.5),
    "encoder": ("prototype", 0.5),
    "pwm": ("prototype", 1.5),
    "fixed_point": ("prototype", 0.5),
    "serial": ("serial", 0.8),
    "cop": ("watchdog", 1.5),
    "feeders": ("stream", 3.0),
    "parcel_contact": ("rails", 2.5),
}
"""A bundled scene that asks for each effect, and how long it takes to show."""
ON_REQUEST = {"scanners", "camera"}
"""What programs ask for: a scene whose cells make something of it can't do without."""


def study(scene: Scene) -> EffectStudy:
    return EffectStudy(scene, 1, lambda line: None)


def traced(scene: Scene, *, cells: bool = False) -> TracedRun:
    return run_variant(scene, cells=cells, notify=silent)


def loaded(name: str, *sets: str, duration: float | None = None) -> Scene:
    return load_scene(name, list(sets), duration=duration)


def test_every_effect_is_shown_by_a_bundled_scene() -> None:
    assert SHOWN.keys() | ON_REQUEST == effect_types().keys()


@pytest.mark.slow
@pytest.mark.parametrize("effect", SHOWN)
def test_where_an_effect_counts_its_influence_is_far_above_the_solver_s_error(effect: str) -> None:
    name, duration = SHOWN[effect]
    row = study(loaded(name, duration=duration)).row(effect)
    assert row.on
    assert row.reason == ""
    assert row.influence is not None
    assert row.error is not None
    assert row.cost is not None
    assert row.cost.ratio is not None
    assert row.cost.ratio > 0.0
    if effect == "feeders":  # without it there is no parcel
        assert row.influence.parcels > 0
        assert row.error.none
    else:
        assert row.influence.displacement_m is not None
        assert row.error.displacement_m is not None
        assert row.influence.displacement_m > 100.0 * row.error.displacement_m
        assert row.influence.displacement_m > 1e-6


@pytest.mark.parametrize(
    ("effect", "scene"),
    [
        ("parcel_contact", "elliptic"),  # one parcel and no rail
        ("sensor", "heat"),  # firmware that doesn't look
        ("link_delay", "motors"),  # firmware that doesn't talk
        ("link_loss", "motors"),
        ("serial", "motors"),
    ],
)
def test_an_effect_with_nothing_to_do_moves_nothing_at_all(effect: str, scene: str) -> None:
    row = study(loaded(scene, duration=0.3)).row(effect)
    assert not row.on
    assert row.influence is not None
    assert row.influence.none
    assert (row.influence.displacement_m, row.influence.turn_rad, row.influence.only) == (0.0, 0.0, (0, 0))


@pytest.mark.slow
def test_contacts_that_are_only_reported_move_nothing() -> None:
    row = study(loaded("rails", "effects.parcel_contact.mode=report_only", duration=2.5)).row(
        "parcel_contact"
    )
    assert row.influence is not None
    assert (row.influence.displacement_m, row.influence.turn_rad) == (0.0, 0.0)
    assert row.influence.only[0] > 0


def test_an_effect_that_the_scene_lacks_is_tried_with_what_it_needs_on_both_sides() -> None:
    pair = ablate(loaded("elliptic"), "wheel_load")
    assert pair.beside == ("motors",)
    assert tables(pair.on).keys() - tables(pair.off).keys() == {"wheel_load"}
    assert tables(pair.off).keys() == {"motors"}
    assert pair.on.solver == pair.off.solver
    assert pair.on.solver.name == "implicit"
    assert pair.cells


def test_an_effect_goes_with_those_that_build_on_it() -> None:
    pair = ablate(loaded("loaded"), "motors")
    assert pair.along == ("wheel_load",)
    assert tables(pair.off) == {}
    assert pair.off.cells.speed_loop is None


def test_what_asks_more_of_an_effect_by_its_settings_goes_with_it() -> None:
    pair = ablate(loaded("spots"), "analogue_sensors")
    assert pair.along == ("adc", "sensor")
    # a sensor that asks nothing of levels stays
    pair = ablate(loaded("noisy", "effects.analogue_sensors.spot_radius_m=0.01"), "analogue_sensors")
    assert pair.along == ()
    assert ablate(loaded("noisy"), "adc").beside == ("analogue_sensors",)


def test_both_sides_differ_in_nothing_but_the_effect() -> None:
    pair = ablate(loaded("uneven"), "uneven_supports")
    assert variant(pair.off, tables(pair.on)).canonical() == pair.on.canonical()
    assert not pair.cells


@pytest.mark.parametrize("name", bundled_names())
def test_every_bundled_scene_can_be_varied_and_stays_the_same_if_it_is_not(name: str) -> None:
    scene = loaded(name)
    assert variant(scene, tables(scene)).canonical() == scene.canonical()


@pytest.mark.parametrize(
    ("scene", "sets", "effect", "reason"),
    [
        ("rolling", (), "motors", "friction.law: has motors of its own; leave effects.motors out"),
        ("elliptic", (), "feeders", "no typical settings: feeders and exits depend on the scene"),
        ("rails", (), "load_transfer", "effects.load_transfer: doesn't go with effects.parcel_contact"),
    ],
)
def test_what_can_t_be_toggled_says_why(scene: str, sets: Sequence[str], effect: str, reason: str) -> None:
    with pytest.raises(VariantRejected) as caught:
        ablate(loaded(scene, *sets), effect)
    assert str(caught.value) == reason
    row = study(loaded(scene, *sets)).row(effect)
    assert (row.influence, row.cost, row.reason) == (None, None, reason)


@pytest.mark.parametrize(
    ("sets", "names"),
    [
        (("effects.wheel_load.inertia_kg=0.1",), ("effects.motors", "effects.wheel_load needs it")),
        (("effects.adc={}",), ("effects.analogue_sensors", "effects.adc needs it")),
        (("effects.sensor.threshold=0.5",), ("effects.analogue_sensors", "effects.sensor needs it")),
        (("effects.sensor.hysteresis=0.1",), ("effects.analogue_sensors", "effects.sensor needs it")),
        (
            ("effects.load_transfer.centre_of_mass_height_m=0.05", "effects.parcel_contact={}"),
            ("effects.load_transfer", "doesn't go with effects.parcel_contact"),
        ),
    ],
)
def test_a_contradiction_between_effects_names_both(sets: Sequence[str], names: Sequence[str]) -> None:
    with pytest.raises(SceneError) as caught:
        loaded("elliptic", "solver={ name = 'implicit' }", *sets)
    (line,) = str(caught.value).splitlines()
    assert all(name in line for name in names)


def test_the_plant_alone_moves_a_field_s_parcels_as_with_cells_to_the_last_bit() -> None:
    scene = loaded("elliptic", duration=0.4)
    assert not needs_cells(scene)
    found = compare(traced(scene, cells=True), traced(scene, cells=False))
    assert found.none
    assert found.events > 0


@pytest.mark.parametrize(
    ("scene", "sets"),
    [
        ("heat", ()),
        ("motors", ()),
        ("elliptic", ("effects.sensor={}",)),
        ("elliptic", ("faults=[{ at_s = 0.1, cell = [9, 9] }]",)),
    ],
)
def test_cells_run_where_they_do_more_than_hold_a_field(scene: str, sets: Sequence[str]) -> None:
    assert needs_cells(loaded(scene, *sets))


@pytest.mark.parametrize(
    ("sets", "key", "finer"),
    [
        (("solver.tolerance=1e-9",), "tolerance", 1e-10),
        (("solver={ name = 'implicit', step_s = 1e-3 }",), "step_s", 1e-4),
        (("solver.tolerance=1e-14",), "tolerance", None),
    ],
)
def test_the_solver_s_own_error_is_estimated_by_a_tenth_of_its_tolerance_or_step(
    sets: Sequence[str], key: str, finer: float | None
) -> None:
    found = refined(loaded("elliptic", *sets))
    if finer is None:
        assert found is None
    else:
        assert found is not None
        assert found.solver.accuracy()[key] == pytest.approx(finer)


@pytest.mark.slow
def test_the_solver_s_error_is_that_of_the_worse_side() -> None:
    coulomb = 'friction={law="coulomb",coefficient=0.3}'
    scene = loaded("uneven", "solver.tolerance=1e-3", coulomb, duration=0.6)
    pair = ablate(scene, "uneven_supports")
    finer = [refined(side) for side in (pair.on, pair.off)]
    errors = [
        compare(traced(side), traced(fine)).displacement_m or 0.0
        for side, fine in zip((pair.on, pair.off), finer, strict=True)
        if fine is not None
    ]
    row = study(scene).row("uneven_supports")
    assert row.error is not None
    assert row.error.displacement_m == max(errors) > 1e-9


def test_the_cost_is_the_median_over_rounds_of_which_finer_runs_are_none(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    run = traced(loaded("elliptic", duration=0.05))
    with_it, without = iter([9.0, 3.0, 50.0]), iter([1.0, 2.0, 1.5])

    def timed(scene: Scene, *, cells: bool, notify: object) -> TracedRun:
        finer = scene.solver.accuracy()["tolerance"] != 1e-9
        on = scene.effects.parcel_contact is not None
        wall_s = 1e3 if finer else next(with_it if on else without)
        return replace(run, result=replace(run.result, wall_s=wall_s))

    monkeypatch.setattr(study_module, "run_variant", timed)
    row = EffectStudy(loaded("elliptic", duration=0.05), 3, silent).row("parcel_contact")
    assert row.cost == Cost([9.0, 3.0, 50.0], [1.0, 2.0, 1.5])
    assert row.cost.ratio == 6.0
    assert row.cost.seconds == 8.0
    assert row.cost.range_s == (1.0, 48.5)
    assert not row.cost.is_noise


def test_a_cost_on_whose_sign_rounds_disagree_is_noise_and_one_round_shows_none() -> None:
    assert Cost([1.1, 0.9], [1.0, 1.0]).is_noise
    assert not Cost([1.1, 1.2], [1.0, 1.0]).is_noise
    assert Cost([1.1], [1.0]).range_s is None
    assert not Cost([1.1], [1.0]).is_noise


def test_a_scene_that_is_a_side_of_several_pairs_is_run_once_a_round(monkeypatch: pytest.MonkeyPatch) -> None:
    runs: list[bytes] = []

    def counted(scene: Scene, *, cells: bool, notify: Any) -> TracedRun:
        runs.append(scene.canonical())
        return run_variant(scene, cells=cells, notify=notify)

    monkeypatch.setattr(study_module, "run_variant", counted)
    scene = loaded("noisy", duration=0.02)
    EffectStudy(scene, 2, silent).rows(["sensor", "link_delay", "link_loss"])
    # the scene and three without an effect, each under a finer solver once and twice as it is
    assert sorted(Counter(runs).values()) == [1] * 4 + [2] * 4
    assert runs.count(scene.canonical()) == 2


@pytest.mark.slow
def test_a_difference_that_is_gone_at_the_end_is_an_influence() -> None:
    row = study(loaded("elliptic", duration=20.0)).row("contact_width")
    assert row.influence is not None
    assert row.influence.displacement_m == pytest.approx(1.42e-3, rel=0.01)
    assert row.influence.at_s == pytest.approx(5.12, abs=0.02)
    assert row.influence.end_m is not None
    assert row.influence.end_m < 1e-4


def test_a_plant_that_refuses_one_side_is_a_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def refused(scene: Scene, *, cells: bool, notify: object) -> Any:
        raise InputError("parcels[0] doesn't stand")

    monkeypatch.setattr(study_module, "run_variant", refused)
    row = study(loaded("elliptic")).row("motors")
    assert (row.influence, row.cost, row.reason) == (None, None, "parcels[0] doesn't stand")


def test_a_run_that_ends_early_is_a_reason_and_no_figure(monkeypatch: pytest.MonkeyPatch) -> None:
    def stopped(scene: Scene, *, cells: bool, notify: Any) -> TracedRun:
        run = run_variant(scene, cells=cells, notify=notify)
        if scene.effects.parcel_contact:
            run.result.end("unstable", "it blew up")
        return run

    monkeypatch.setattr(study_module, "run_variant", stopped)
    row = study(loaded("elliptic", duration=0.05)).row("parcel_contact")
    assert (row.influence, row.error, row.cost) == (None, None, None)
    assert row.reason == "with it: it blew up"


def test_a_compilation_is_announced_once_and_a_loaded_kernel_is_not() -> None:
    import numba

    told: list[str] = []
    with compilation_announced(told.append):
        doubled = numba.njit(lambda value: value + value)
        assert told == []
        assert (doubled(1), doubled(1.0), doubled(2)) == (2, 2.0, 4)
    assert [line.partition(" (")[0] for line in told] == ["compiling kernels"]
    with compilation_announced(told.append):
        doubled(3)
    assert len(told) == 1


def test_a_program_that_fails_is_a_reason(tmp_path: Path) -> None:
    program = tmp_path / "failing.py"
    program.write_text(
        "from mdms import CellFirmware, CellOutputs\n\n\n"
        "class Failing(CellFirmware):\n"
        "    def init(self, cell):\n        return 0\n\n"
        "    def step(self, state, inputs):\n"
        "        return state + 1 + 0 // (5 - state), CellOutputs((0.1, 0.0), {})\n"
    )
    scene = loaded("elliptic", f"cells.firmware={program}", "cells.parameters={}", duration=0.1)
    row = study(scene).row("sensor")
    assert row.influence is None
    assert row.reason.startswith("with it: ")
    assert "ZeroDivisionError" in row.reason
