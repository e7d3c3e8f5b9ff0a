"""Advice sorts effects by whether they change the answer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from deploy.commands.options import load_scene
from deploy.studies.effects.advice import advise
from deploy.studies.effects.sensitivity import Sensitivity
from deploy.studies.effects.study import AblationRow, EffectStudy


def moved(metres: float | None, parcels: int = 0) -> Sensitivity:
    return Sensitivity(
        displacement_m=metres,
        turn_rad=0.0,
        end_m=0.0,
        end_rad=0.0,
        parcels=parcels,
        settled_s=(None, None),
        events=0,
        moved=None,
        only=(0, 0),
    )


def row(name: str, metres: float | None, *, on: bool, error: float = 0.0, **more: Any) -> AblationRow:
    return AblationRow(name=name, on=on, influence=moved(metres, **more), error=moved(error))


def names(rows: Sequence[AblationRow]) -> list[str]:
    return [row.name for row in rows]


@pytest.fixture
def study() -> EffectStudy:
    return EffectStudy(load_scene("elliptic", duration=0.05), 1, lambda line: None)


def test_effects_are_sorted_by_the_tolerance_and_by_whether_they_are_on(study: EffectStudy) -> None:
    rows = [
        row("motors", 2e-3, on=True),
        row("contact_width", 1e-3, on=False),
        row("uneven_supports", 0.9e-3, on=False),
    ]
    found = advise(study, rows, 1e-3)
    assert (names(found.can_go), names(found.missing), found.unclear) == ([], ["contact_width"], ())
    assert found.together is None


def test_a_parcel_more_or_less_is_another_answer(study: EffectStudy) -> None:
    assert names(advise(study, [row("feeders", None, on=False, parcels=1)], 1e-3).missing) == ["feeders"]


def test_no_advice_is_given_below_the_solver_s_error(study: EffectStudy) -> None:
    found = advise(study, [row("motors", 2e-4, on=True, error=1e-3)], 1e-3)
    assert (found.can_go, found.missing, found.unclear) == ((), (), ("motors",))


def test_nothing_is_said_of_what_could_not_be_toggled(study: EffectStudy) -> None:
    found = advise(study, [AblationRow(name="feeders", on=False, reason="only a scene can say")], 1e-3)
    assert (found.can_go, found.missing, found.unclear) == ((), (), ())


@pytest.mark.slow
def test_effects_that_can_go_are_left_out_all_at_once_too() -> None:
    scene = load_scene("loaded", duration=0.15)
    study = EffectStudy(scene, 1, lambda line: None)
    rows = study.rows(["motors", "wheel_load"])
    influences = {one.name: one.influence for one in rows}
    found = advise(study, rows, 1.0)
    assert names(found.can_go) == ["motors", "wheel_load"]
    assert found.together is not None
    assert found.together.influence == influences["motors"]  # which takes wheel_load along
    assert found.together.influence != influences["wheel_load"]
    assert len(found.together.cost.with_s) == 1
    alone = advise(study, rows[:1], 1.0)
    assert names(alone.can_go) == ["motors"]
    assert alone.together == found.together
