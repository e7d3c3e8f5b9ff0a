"""How a study is cut down to a section of the page."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from deploy.studies.accuracy.experiments import sweep
from deploy.studies.accuracy.reference import Agreement, Reference
from deploy.studies.accuracy.report import AccuracyReport, AccuracyRow


def _row(
    line: str, key: str, value: float, error: float | None, wall_s: float | None, status: str = "ok"
) -> AccuracyRow:
    return AccuracyRow(
        solver=line.split(maxsplit=1)[0],
        line=line,
        setting=f"{key} {value:g}",
        key=key,
        value=value,
        status=status,
        reason=None if status == "ok" else "takes too long",
        error_max=error,
        error_end=error,
        wall_s=wall_s,
        wall_low_s=wall_s,
        wall_high_s=wall_s,
        solver_s=wall_s,
        solver_low_s=wall_s,
        solver_high_s=wall_s,
    )


@pytest.fixture
def report() -> AccuracyReport:
    rows = [
        replace(_row("exact", "tolerance", 1e-4, 3e-6, 0.001), order_until=2.5, error_before=1e-9),
        _row("exact", "tolerance", 1e-6, 2e-9, 0.002),
        _row("fixed_step rk4", "step_s", 1e-2, 4e-4, 0.003),
        _row("fixed_step rk4", "step_s", 1e-3, 5e-4, 0.03),
        _row("scipy DOP853", "tolerance", 1e-9, 1.5e-5, 0.2),
        _row("scipy Radau", "tolerance", 1e-9, None, None, "stopped"),
        *[replace(_row("heyoka", "tolerance", 0.1, None, None, "omitted"), reason="not installed")] * 2,
    ]
    reference = Reference(
        "heyoka, tolerance 1e-14",
        "heyoka",
        None,  # type: ignore[arg-type] - no trace is read
        None,
        [Agreement("closed form", "centre of mass", 2e-15, 10.0)],
        None,
        ("A note.",),
    )
    return AccuracyReport("elliptic", "Title", 10.0, 400, 1, 0.004, False, reference, rows, ())


def test_the_coarsest_setting_that_reaches_each_target_is_listed_with_its_time(
    report: AccuracyReport,
) -> None:
    text = sweep.describe(report, 5).text
    assert "| solver | 1e-3 m | 1e-5 m | 1e-7 m | 1e-9 m | 1e-11 m |" in text
    assert "| exact | 1e-4: 1 ms | 1e-4: 1 ms | 1e-6: 2 ms | – | – |" in text
    # the finer step is no better: which row is listed depends on errors alone, not on how long runs took
    assert "| fixed_step rk4 | 0.01: 3 ms | – | – | – | – |" in text
    assert "| scipy DOP853 | 1e-9: 200 ms | – | – | – | – |" in text
    assert "| scipy Radau" not in text


def test_errors_over_tolerances_reference_and_failures_are_listed(report: AccuracyReport) -> None:
    text = sweep.describe(report, 5).text
    assert "exact 3.0e-2, scipy DOP853 1.5e4." in text
    assert "Reference: heyoka, tolerance 1e-14:" in text
    assert "- closed form: 2e-15 m from it (centre of mass, to 10 s)" in text
    assert "- A note." in text
    assert (
        "- The order of events is not the reference's with exact 1e-4 from 2.5 s (1.0e-09 m before)." in text
    )
    assert text.count("- heyoka: omitted: not installed.") == 1
    assert "- scipy Radau 1e-9: stopped: takes too long." in text


def test_the_sampling_cost_has_a_plot_only_where_it_was_requested(
    report: AccuracyReport, tmp_path: Path
) -> None:
    section = sweep.describe(report, 5)
    assert set(section.pictures) == {"elliptic_cost.png", "elliptic_tolerance.png"}
    for name, draw in section.pictures.items():
        draw(tmp_path / name)
        assert (tmp_path / name).stat().st_size > 10_000
