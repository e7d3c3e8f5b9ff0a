"""A campaign's criterion of success: from the command line, from the scene's goal, or refused."""

from __future__ import annotations

from typing import Any

import pytest

from deploy.cli import main
from deploy.errors import InputError
from deploy.scenes.errors import SceneError
from deploy.scenes.files import bundled_names, load_scene, scene_text
from deploy.scenes.overrides import Override
from deploy.studies.campaign.cases import cases_of
from deploy.studies.campaign.criterion import Criterion
from deploy.studies.campaign.spec import read_options

WITHOUT_GOAL = "bumpy"
FAULT: dict[str, Any] = {"fault": "crash", "share": "0.1"}
PLACE = ("goal={ place_m = [0.1, 0.0], within_m = 0.02 }",)


def _criterion(scene: str = WITHOUT_GOAL, **given: Any) -> Criterion:
    return cases_of(read_options({"scene": scene, **given}), scene_text(scene)).cases[0].criterion


def test_a_campaign_for_which_nothing_says_what_success_is_is_refused_before_anything_runs(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["campaign", WITHOUT_GOAL, "--fault", "crash", "--share", "0:0.5:0.25"]) == 2
    error = capsys.readouterr().err
    assert error.splitlines()[-1].startswith(
        f"mdms: campaign: no criterion of success for {WITHOUT_GOAL}: give --within METRES"
    ) or error.startswith(f"campaign: no criterion of success for {WITHOUT_GOAL}: give --within METRES")
    with pytest.raises(InputError, match=r"no baseline run to compare with; give the scene a \[goal\]"):
        _criterion(vary=("parcels.0.mass_kg=1,2",))
    with pytest.raises(InputError, match=r"--within 0\.1: no reference for errors"):
        _criterion(vary=("parcels.0.mass_kg=1,2",), within_m=0.1)


def test_the_command_line_or_the_scenes_goal_defines_success_and_the_source_is_named() -> None:
    assert _criterion(**FAULT, within_m=0.1).words() == (
        "error at most 0.1 m from where the baseline run ends (--within)"
    )
    assert _criterion("elliptic", **FAULT).words() == (
        "error at most 0.05 m from where the baseline run ends (the scene's goal)"
    )
    assert _criterion("elliptic", **FAULT, within_m=0.2).words() == (
        "error at most 0.2 m from where the baseline run ends (--within)"
    )
    assert _criterion(set=PLACE).words() == "error at most 0.02 m from (0.1, 0) m (the scene's goal)"
    assert _criterion(**FAULT, within_m=0.1, set=("goal.at_rest=true",)).words() == (
        "error at most 0.1 m from where the baseline run ends, every parcel at rest or delivered "
        "(--within and the scene's goal)"
    )


def test_a_goal_can_be_varied() -> None:
    spec = read_options({"scene": "elliptic", **FAULT, "vary": ("goal.within_m=0.01,0.1",)})
    found = cases_of(spec, scene_text("elliptic"))
    assert [case.criterion.within_m for case in found.cases] == [0.01, 0.1]


def test_a_goal_changes_no_digest() -> None:
    with_goal = load_scene(WITHOUT_GOAL, [Override.parse(PLACE[0])])
    assert with_goal.canonical() == load_scene(WITHOUT_GOAL).canonical()


@pytest.mark.parametrize(
    ("goal", "rule"),
    [
        ("{}", "a goal must demand something"),
        ("{ place_m = [0.0, 0.0], at_rest = true }", "place_m needs within_m"),
    ],
)
def test_a_goal_that_demands_nothing_is_refused(goal: str, rule: str) -> None:
    with pytest.raises(SceneError, match=rule):
        load_scene(WITHOUT_GOAL, [Override.parse(f"goal={goal}")])


def test_scenes_whose_campaigns_the_help_shows_have_goals_of_their_own() -> None:
    shown = {"elliptic", "align", "noisy", "heat", "junction"}
    assert shown <= {name for name in bundled_names() if load_scene(name).goal is not None}
