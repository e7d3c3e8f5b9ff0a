"""The table and the picture show what there is, whatever is varied."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from deploy.scenes.files import scene_text
from deploy.studies.campaign.cases import cases_of
from deploy.studies.campaign.console import print_report
from deploy.studies.campaign.plot import draw_campaign, why_none
from deploy.studies.campaign.report import CampaignReport, aggregate
from deploy.studies.campaign.result import CaseOutcome
from deploy.studies.campaign.spec import read_options

ONE = "cells.parameters.diffusion_number=0.05:0.25:0.05"
TWO = "parcels.0.mass_kg=1,2,3"
WORDS = "stall.policy=coast,brake,hold"


def made_up(folder: Path, *vary: str, seeds: int = 3, **more: Any) -> CampaignReport:
    """A campaign that never was: a run in four fails, errors and times rise with the case."""
    spec = read_options({"scene": "heat", "vary": vary, "seeds": str(seeds), **more})
    cases = cases_of(spec, scene_text("heat"))
    outcomes = {
        (case.number, seed): CaseOutcome(
            status="failed" if (case.number + seed) % 4 == 0 else "ok",
            reason=f"[bold] of {case.number}",
            succeeded=(case.number + seed) % 4 > 1,
            error_m=0.1 * case.number + 0.01 * seed,
            time_s=None if case.number == 1 else 1.0 + case.number + 0.1 * seed,
            cells_lost=0,
            digest=None,
            wall_s=0.1,
        )
        for case in cases.cases
        for seed in cases.seeds
    }
    rows = tuple(aggregate(cases, outcomes, spec.confidence))
    return CampaignReport(
        status="ok", reason="", spec=spec, cases=cases, outcomes=outcomes, rows=rows, folder=folder
    )


@pytest.mark.parametrize("vary", [(ONE,), (WORDS, "duration_s=5"), (ONE, WORDS)])
def test_a_picture_is_drawn_of_one_value_or_of_two(vary: tuple[str, ...], tmp_path: Path) -> None:
    report = made_up(tmp_path, *vary)
    assert why_none(report) == ""
    draw_campaign(report, tmp_path / "campaign.png")
    assert (tmp_path / "campaign.png").read_bytes().startswith(b"\x89PNG")


def test_of_no_value_and_of_three_there_is_no_picture_and_it_is_said_why(tmp_path: Path) -> None:
    assert why_none(made_up(tmp_path)) == "no value is varied"
    assert why_none(made_up(tmp_path, "duration_s=5")) == "no value is varied"
    assert why_none(made_up(tmp_path, ONE, TWO, WORDS)).startswith("3 values are varied")


def test_the_table_has_a_row_a_case_and_lists_the_first_failed_runs_as_they_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    print_report(made_up(tmp_path, ONE, TWO))
    lines = capsys.readouterr().out.splitlines()
    assert lines[1].startswith("success: error at most ")
    assert lines[3].split()[:2] == ["diffusion_number", "mass_kg"]
    assert lines[4].split()[:4] == ["0.05", "1", "3", "0"]
    assert len([line for line in lines if "(" in line and "–" in line]) == 15
    assert (
        "  cells.parameters.diffusion_number 0.05, parcels.0.mass_kg 2, seed 3: failed: [bold] of 1" in lines
    )
    assert lines[-1].startswith("  and ")


def test_the_csv_has_a_line_a_case_and_empty_fields_for_what_there_is_not(tmp_path: Path) -> None:
    head, *lines = made_up(tmp_path, WORDS, seeds=1).to_csv().splitlines()
    assert head == (
        "stall.policy,runs,failed,succeeded,success,success_low,success_high,"
        "time_s,time_s_low,time_s_high,error_m,error_m_low,error_m_high"
    )
    assert lines[0] == "coast,1,0,0,0.0,,,1.1,,,0.01,,"
    assert lines[1] == "brake,1,0,1,1.0,,,,,,0.11,,"
