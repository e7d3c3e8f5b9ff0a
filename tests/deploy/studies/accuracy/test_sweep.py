"""Which solvers and settings a study tries."""

from __future__ import annotations

from typing import get_args

import pytest
from pydantic import TypeAdapter

from deploy.commands.options import load_scene
from deploy.studies.accuracy.sweep import lines, refusal, with_solver
from plant.solver_specs import AnySolver, SolverSpec

SCENE = load_scene("elliptic", ["solver.capture_m=1e-7"])
LINES = list(lines(SCENE))


def test_every_solver_there_is_takes_part() -> None:
    names = {get_args(spec.model_fields["name"].annotation)[0] for spec in get_args(AnySolver)}
    assert {line[0].solver for line in LINES} == names


@pytest.mark.parametrize("line", LINES, ids=lambda line: line[0].line)
def test_every_setting_is_one_of_the_solver_s_and_they_go_from_coarse_to_fine(line: tuple) -> None:
    values = [trial.value for trial in line]
    assert values == sorted(set(values), reverse=True)
    for trial in line:
        spec = TypeAdapter(SolverSpec).validate_python(trial.settings)
        assert getattr(spec, trial.key) == trial.value


def test_no_two_lines_have_one_name() -> None:
    names = [line[0].line for line in LINES]
    assert len(set(names)) == len(names)


def test_quick_values_are_among_all_values() -> None:
    for spec in get_args(AnySolver):
        for sweep in spec.sweeps:
            assert set(sweep.quick) <= set(sweep.values)


def test_exact_runs_at_every_tolerance_from_1e_4_to_1e_12() -> None:
    (line,) = (line for line in LINES if line[0].solver == "exact")
    assert [trial.value for trial in line] == [float(f"1e-{k}") for k in range(4, 13)]


def test_what_the_scene_sets_for_its_own_solver_stays() -> None:
    trials = [trial for line in LINES for trial in line]
    assert all(("capture_m" in trial.settings) == (trial.solver == "exact") for trial in trials)
    assert with_solver(SCENE, LINES[0][0].settings).solver.capture_m == 1e-7  # type: ignore[union-attr]


def test_a_solver_that_does_not_claim_the_scene_names_the_rule() -> None:
    assert refusal(SCENE, {"name": "exact", "tolerance": 1e-9}) is None
    coulomb = load_scene("coulomb")
    why = refusal(coulomb, {"name": "exact", "tolerance": 1e-9})
    assert why is not None
    assert "not coulomb" in why
