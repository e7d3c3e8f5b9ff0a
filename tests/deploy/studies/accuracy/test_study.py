"""A study judges every solver that claims a scene, lists the others, and says the same twice."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace

import pytest

from deploy.commands.options import load_scene
from deploy.errors import InputError
from deploy.runs.field_simulation import without_cells
from deploy.studies.accuracy import study as studied
from deploy.studies.accuracy.errors import compare_events, displacement_m
from deploy.studies.accuracy.reference import METHODS, ReferenceSolver
from deploy.studies.accuracy.report import AccuracyReport, AccuracyRow
from deploy.studies.accuracy.study import StudyPlan, study
from deploy.studies.accuracy.sweep import lines, with_solver
from deploy.studies.accuracy.trace import run_trace
from plant.solvers import restarting as restarted

PLAN = StudyPlan(quick=True, repeats=1, limit_s=20.0, sampling=False)
TIMES = (
    "wall_s", "wall_low_s", "wall_high_s", "noise_low_s", "noise_high_s", "relative", "solver_s", "solver_low_s",
    "solver_high_s", "speed",
)  # fmt: skip


@pytest.fixture(scope="module")
def short() -> AccuracyReport:
    """Of the first 0.9 s of ``elliptic``, a graze among them."""
    return study(load_scene("elliptic", duration=0.9), PLAN)


def timeless(row: AccuracyRow) -> AccuracyRow:
    return replace(row, **dict.fromkeys(TIMES))


def test_the_error_of_exact_never_exceeds_ten_times_the_requested_tolerance_on_elliptic() -> None:
    scene = without_cells(load_scene("elliptic"))
    reference = ReferenceSolver(scene, limit_s=60.0, methods=METHODS[2:]).solve()
    (line,) = (line for line in lines(scene) if line[0].solver == "exact")
    for trial in line:
        trace = run_trace(with_solver(scene, trial.settings))
        judge, known = reference.judge("exact")
        assert judge == "implicit"
        off = displacement_m(trace.state, known.state, known.footprints_m)
        assert off.max() < 10.0 * trial.value
        events = compare_events(trace.events, known.events, reference.duration_s)
        assert (events.found, events.missed, events.order_until_s) == (86, 0, None)


def test_two_studies_agree_in_all_but_their_times(short: AccuracyReport) -> None:
    again = study(load_scene("elliptic", duration=0.9), PLAN)
    assert [timeless(row) for row in again.rows] == [timeless(row) for row in short.rows]
    assert again.reference.agreement == short.reference.agreement


def test_every_solver_that_claims_the_scene_is_judged_timed_and_counted(short: AccuracyReport) -> None:
    judged = [row for row in short.rows if row.status == "ok"]
    assert {row.solver for row in judged} >= {"exact", "implicit", "quasi_static", "fixed_step"}
    for row in judged:
        assert row.error_max is not None
        assert row.error_end is not None
        assert 0.0 <= row.error_end <= row.error_max
        assert row.wall_s is not None
        assert row.wall_s > 0.0
        assert row.speed == pytest.approx(0.9 / row.wall_s)
        assert row.solver_s is not None
        assert 0.0 < row.solver_s < row.wall_s
        assert row.effort is not None
        assert row.effort > 10
        assert row.judged_by != row.solver


def test_finer_settings_of_exact_err_less_and_find_every_event(short: AccuracyReport) -> None:
    rows = [row for row in short.rows if row.solver == "exact"]
    errors = [row.error_max or 0.0 for row in rows]
    assert 1e-10 > errors[0] > 10.0 * errors[1] > 1e-13
    assert max(errors[2:]) < 1e-14
    assert rows[-1].events_found == 38
    assert all(row.events_missed == 0 and row.order_until is None for row in rows)


def test_the_graze_that_scipy_s_long_steps_hide_is_found_late_and_shows_at_any_tolerance() -> None:
    pytest.importorskip("scipy")
    scene = without_cells(load_scene("elliptic", duration=0.9))
    known = run_trace(with_solver(scene, {"name": "exact", "tolerance": 1e-12}))
    lost = run_trace(with_solver(scene, {"name": "scipy", "method": "DOP853", "tolerance": 1e-9}))
    found = compare_events(lost.events, known.events, 0.9)
    assert found.time_error_s == pytest.approx(0.002494, abs=1e-6)
    assert displacement_m(lost.state, known.state, known.footprints_m).max() > 1e-7


def test_a_model_without_inertia_is_said_to_be_one(short: AccuracyReport) -> None:
    notes = {row.solver: row.note for row in short.rows if row.note}
    assert set(notes) == {"quasi_static"}


def test_after_the_order_of_events_parts_distributions_are_compared(short: AccuracyReport) -> None:
    parted = [row for row in short.rows if row.solver == "quasi_static"]
    for row in parted:
        assert row.order_until is not None
        assert row.order_until < 0.1
        assert row.error_before is not None
        assert row.error_max is not None
        assert row.error_before <= row.error_max
        assert row.speed_distance is not None
        assert 0.0 < row.speed_distance <= 1.0


def test_omissions_are_rows_with_the_rule_in_the_table_json_and_csv() -> None:
    report = study(load_scene("coulomb", duration=0.05), PLAN)
    left_out = {
        row.line for row in report.rows if row.status == "omitted" and "not coulomb" in (row.reason or "")
    }
    assert {"exact", "heyoka", "scipy RK45", "scipy DOP853"} <= left_out
    in_json = {row["line"]: row for row in json.loads(report.to_json())["rows"]}
    assert in_json["exact"]["status"] == "omitted"
    assert in_json["exact"]["error_max"] is None
    table = list(csv.DictReader(io.StringIO(report.to_csv())))
    assert [row["line"] for row in table] == [row.line for row in report.rows]
    (row,) = (row for row in table if row["line"] == "exact")
    assert row["error_max"] == ""
    assert "not coulomb" in row["reason"]


def test_a_run_that_fails_is_a_row_with_its_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("scipy")
    monkeypatch.setattr(restarted, "CHANGES_PER_SECOND", 1)
    monkeypatch.setattr(restarted, "CHANGES_PER_MEMBER", 0)
    report = study(load_scene("elliptic", duration=0.4), PLAN)
    rows = [row for row in report.rows if row.solver == "scipy" and row.value]
    assert rows
    for row in rows:
        assert row.status == "unstable"
        assert "support changes without end" in (row.reason or "")
        assert row.error_max is None


def test_a_quick_study_that_runs_out_of_time_lists_what_it_did_not_begin(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(studied, "QUICK_S", -1.0)
    monkeypatch.setattr(studied, "QUICK_LEFT_S", -1.0)
    report = study(load_scene("elliptic", duration=0.05), PLAN)
    assert report.rows
    assert all(row.status == "omitted" and row.reason for row in report.rows)


def test_a_quick_study_of_many_parcels_does_without_references_made_one_parcel_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(studied, "QUICK_PARCELS", 0)
    report = study(load_scene("elliptic", duration=0.05), PLAN)
    assert report.reference.method.startswith("implicit")


def test_a_scene_without_parcels_is_refused() -> None:
    with pytest.raises(InputError, match="has no parcels"):
        study(load_scene("elliptic", ["parcels=[]"]), PLAN)
