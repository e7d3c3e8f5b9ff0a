"""Every combination is a scene of its own, validated before anything runs."""

from __future__ import annotations

from typing import Any

import pytest

from deploy.errors import InputError
from deploy.scenes.files import load_scene, scene_text
from deploy.scenes.overrides import Override
from deploy.studies.campaign.cases import Cases, cases_of, with_seed
from deploy.studies.campaign.spec import read_options


def cases(**given: Any) -> Cases:
    return cases_of(read_options({"scene": "noisy", **given}), scene_text("noisy"))


def test_a_seed_put_in_later_makes_the_scene_that_it_makes_at_once() -> None:
    later = with_seed(load_scene("noisy"), 7)
    assert later.canonical() == load_scene("noisy", [Override(("seed",), 7, "")]).canonical()
    assert later.name == "noisy"


def test_the_fault_is_added_to_those_of_the_scene_and_is_not_in_the_undisturbed_one() -> None:
    own = "faults=[{ kind = 'crash', at_s = 0.5, cell = [0, 0] }]"
    found = cases(set=(own,), fault="crash", share="0:0.2:0.1", at_s=1.0, until_s=2.0)
    assert [case.values for case in found.cases] == [{"fault.share": value} for value in (0.0, 0.1, 0.2)]
    for case in found.cases:
        before, added = case.scene.faults
        assert before.at_s == 0.5
        assert (added.kind, added.at_s, added.until_s) == ("crash", 1.0, 2.0)
        assert added.share == case.values["fault.share"]
        assert case.baseline is not None
        assert [fault.at_s for fault in case.baseline.faults] == [0.5]


def test_cases_that_differ_in_the_fault_alone_have_one_undisturbed_run_a_seed() -> None:
    found = cases(fault="crash", share="0,0.5", vary=("duration_s=1,2",), seeds="2")
    keys = {case.baseline_id(seed) for case in found.cases for seed in found.seeds}
    assert (found.runs, len(keys)) == (8, 4)


def test_keys_of_the_fault_are_set_and_varied_as_those_of_the_scene() -> None:
    found = cases(fault="crash", set=("fault.rectangle=[[0, 0], [1, 1]]",), vary=("fault.until_s=0.5,1.5",))
    assert [case.scene.faults[0].until_s for case in found.cases] == [0.5, 1.5]


def test_a_fault_without_a_target_affects_every_cell() -> None:
    found = cases(fault="link_loss", vary=("fault.probability=0.1,0.2",))
    faults: list[Any] = [case.scene.faults[0] for case in found.cases]
    assert [(fault.share, fault.probability) for fault in faults] == [(1.0, 0.1), (1.0, 0.2)]


def test_against_gives_the_undisturbed_run_other_values() -> None:
    found = cases(
        vary=("effects.link_loss.probability=0.1,0.2",), against=("effects.link_loss.probability=0",)
    )
    losses = [
        (case.scene.effects.link_loss, case.baseline and case.baseline.effects.link_loss)
        for case in found.cases
    ]
    assert [(own and own.probability, other and other.probability) for own, other in losses] == [
        (0.1, 0.0),
        (0.2, 0.0),
    ]


def test_without_a_fault_and_without_against_nothing_is_compared() -> None:
    found = cases(vary=("duration_s=1,2",))
    assert [case.baseline for case in found.cases] == [None, None]
    assert found.cases[0].baseline_id(1) == ""


@pytest.mark.parametrize(
    ("given", "why"),
    [
        ({"fault": "crush"}, r"faults\[0\]\.kind.*--fault crush"),
        (
            {"fault": "crash", "share": "0,1", "set": ("fault.cell=[0, 0]",)},
            "give one of cell, cells, rectangle, share",
        ),
        ({"fault": "crash", "share": "0:2:1"}, r"faults\[0\]\.share = 2.*from --share 0:2:1, value 2"),
        ({"share": "0,1"}, r"^--share 0,1: needs a fault: --fault KIND"),
        ({"until_s": 3.0}, r"^--until 3: needs a fault"),
        ({"at_s": 3.0}, r"^--at 3: needs a fault"),
        ({"set": ("fault.cell=[0, 0]",)}, r"^--set fault\.cell=\[0, 0\]: needs a fault"),
        ({"fault": "crash", "vary": ("fault=1,2",)}, "must name a key of the fault"),
        ({"fault": "crash", "share": "0,1", "vary": ("fault.share=0,1",)}, "is varied twice"),
        ({"vary": ("cells.periods=1,2",)}, "unknown key; .*period_s"),
        ({"vary": ("duration_s=1:5000:1",), "seeds": "10000"}, "50,000,000 runs; at most 1,000,000"),
        ({"confidence": 1.0}, r"^--confidence 1\.0: must be < 1"),
        ({"limit_s": 0.0}, r"^--limit 0\.0: must be > 0"),
    ],
)
def test_what_makes_no_sense_is_refused_before_anything_runs(given: dict[str, Any], why: str) -> None:
    with pytest.raises(InputError, match=why):
        cases(**given)
