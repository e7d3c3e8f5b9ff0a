"""The cheapest setting for a target, with the noise of times; what the verdict says of it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from deploy.scenes.files import load_scene
from deploy.studies.accuracy.console import answer, print_report, verdict
from deploy.studies.accuracy.plots import line_style
from deploy.studies.accuracy.reference import Agreement, Reference
from deploy.studies.accuracy.report import AccuracyReport, AccuracyRow, noise_s
from deploy.studies.accuracy.sweep import lines
from deploy.studies.accuracy.trace import AccuracyTrace, RunTime

TRACE = AccuracyTrace(np.zeros(2), np.zeros((2, 1, 6)), [], [], RunTime(1.0, 1.0), 1, "ok", None)


def row(solver: str, value: float, error: float, *walls_s: float) -> AccuracyRow:
    low, high = noise_s(walls_s)
    return AccuracyRow(
        solver=solver,
        line=solver,
        setting=f"tolerance {value:g}",
        key="tolerance",
        value=value,
        status="ok",
        error_max=error,
        error_end=error,
        events_found=1,
        wall_s=sorted(walls_s)[len(walls_s) // 2],
        wall_low_s=min(walls_s),
        wall_high_s=max(walls_s),
        noise_low_s=low,
        noise_high_s=high,
        relative=1.0,
        solver_s=min(walls_s),
        speed=1.0,
        effort=1,
    )


def report(*rows: AccuracyRow, apart_m: float = 1e-14) -> AccuracyReport:
    agreement = [
        Agreement("closed form", "centre of mass", 0.0, 1.0),
        Agreement("exact", "corners", apart_m, 1.0),
    ]
    reference = Reference("heyoka, tolerance 1e-14", "heyoka", TRACE, None, agreement, None, ())
    return AccuracyReport("elliptic", "", 10.0, 400, 1, 4e-3, False, reference, rows, ())


EXACT = (
    row("exact", 1e-4, 2e-9, 2.41e-3, 2.33e-3, 2.60e-3, 2.35e-3, 9.9e-3),
    row("exact", 1e-8, 3e-13, 2.43e-3, 2.34e-3, 2.40e-3, 2.36e-3, 2.39e-3),
    row("exact", 1e-12, 4e-16, 2.30e-3, 2.31e-3, 2.35e-3, 2.36e-3, 2.38e-3),
)
SLOW = row("implicit", 1e-6, 2e-9, 80e-3, 81e-3, 82e-3)


def test_settings_that_can_t_be_told_apart_in_time_go_to_the_loosest() -> None:
    found = report(*EXACT, SLOW).cheapest(1e-6)
    assert found is not None
    assert found.row is EXACT[0]
    assert min((one.wall_s or 0.0, one.setting) for one in EXACT)[1] == "tolerance 1e-12"
    assert list(found.ties) == [EXACT[1], EXACT[2]]
    assert found.following is SLOW


def test_a_setting_that_is_faster_beyond_the_noise_is_chosen_though_it_is_finer() -> None:
    slower = row("exact", 1e-4, 2e-9, 3.4e-3, 3.3e-3, 3.6e-3)
    found = report(slower, *EXACT[1:]).cheapest(1e-6)
    assert found is not None
    assert found.row is EXACT[1]


def test_another_solver_as_fast_within_the_noise_is_a_tie() -> None:
    other = row("fixed_step", 4e-3, 8e-7, 2.5e-3, 2.45e-3, 2.6e-3)
    known = report(*EXACT, other, SLOW)
    found = known.cheapest(1e-6)
    assert found is not None
    assert other in found.ties
    assert "A tie with fixed_step tolerance 0.004 (2.5 ms)" in answer(known, 1e-6)


def test_the_noise_leaves_out_the_longest_of_many_runs_and_is_never_nought() -> None:
    assert noise_s([1.0, 1.1, 1.2, 1.3, 9.0]) == (pytest.approx(0.95), pytest.approx(1.05 * 1.3))
    assert noise_s([1.0, 1.1, 9.0]) == (pytest.approx(0.95), pytest.approx(1.05 * 9.0))
    assert noise_s([2.0]) == (pytest.approx(1.6), pytest.approx(2.4))


def test_the_verdict_shares_a_line_between_targets_with_one_answer_and_names_what_is_missed() -> None:
    head, first, second = verdict(report(*EXACT[:2], SLOW))
    assert head == "cheapest by error:"
    assert first == (
        "  0.001, 1e-06 m: exact with tolerance 0.0001, 2.41 ms, 2.0e-09 m off. 1 finer setting can't be told apart "
        "in time (2.39 ms). Next is implicit with tolerance 1e-06 at 34 times"
    )
    assert second == "  1e-09, 1e-12 m: exact with tolerance 1e-08, 2.39 ms, 3.0e-13 m off"
    assert verdict(report(SLOW))[-1] == (
        "  1e-09 m, 1e-12 m: no setting; the nearest is implicit with tolerance 1e-06: 2.0e-09 m in 81 ms"
    )


def test_errors_below_what_checks_confirm_are_said_to_rest_on_the_reference() -> None:
    assert verdict(report(*EXACT, apart_m=2e-5))[-1] == (
        "  smaller errors rest on the reference alone, which is confirmed to 2.0e-05 m only"
    )
    assert "rest on the reference" not in answer(report(*EXACT, apart_m=2e-5), 1e-4)
    assert answer(report(*EXACT, apart_m=2e-5), 1e-6).endswith(
        ". Smaller errors rest on the reference alone, which is confirmed to 2.0e-05 m only"
    )


def test_targets_with_another_runner_up_have_lines_of_their_own() -> None:
    crude = row("fixed_step", 4e-3, 8e-4, 5e-3, 5.1e-3, 5.2e-3)
    coarse, fine = verdict(report(*EXACT, SLOW, crude))[1:3]
    assert coarse.startswith("  0.001 m: exact with tolerance 0.0001, ")
    assert coarse.endswith("Next is fixed_step with tolerance 0.004 at 2.1 times")
    assert fine.startswith("  1e-06 m: exact with tolerance 0.0001, ")


def test_a_study_without_a_single_row_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    print_report(report())
    assert capsys.readouterr().out.startswith("no solver completed elliptic\n")
    assert report().cheapest(math.inf) is None


def test_every_line_has_a_colour_and_a_mark_of_its_own() -> None:
    scene = load_scene("elliptic")
    rows = [replace(row(line[0].solver, 1e-4, 1e-6, 1.0), line=line[0].line) for line in lines(scene)]
    known = report(*rows)
    styles = [line_style(known, line) for line in known.lines]
    assert (
        len({style["color"] for style in styles}) == len({style["marker"] for style in styles}) == len(styles)
    )


def test_a_narrow_terminal_gets_fewer_columns(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "70")
    print_report(report(*EXACT))
    lines = capsys.readouterr().out.splitlines()
    (start,) = (number for number, line in enumerate(lines) if line.startswith("solver "))
    assert lines[start].split() == ["solver", "setting", "error,", "m", "events", "wall,", "ms", "×"]
    assert all(len(line) <= 70 for line in lines[start : start + 4])
    assert any(line.startswith("left out, too wide for this terminal: at end, m; ") for line in lines)
