"""What effects declare of themselves."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from bus.effect import EffectSpec
from deploy.studies.effects.ablation import effect_types
from deploy.studies.effects.report import declared
from plant.observations import Event

PAGE = Path(__file__).parents[4] / "docs" / "effects.md"
EFFECTS = effect_types()


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_has_typical_settings_or_says_why_not(name: str) -> None:
    kind = EFFECTS[name]
    assert kind.default_settings.__func__ is not EffectSpec.default_settings.__func__  # type: ignore[attr-defined]
    typical = kind.default_settings(0.1)
    assert isinstance(typical, kind) or " " in typical


@pytest.mark.parametrize("name", EFFECTS)
def test_what_an_effect_needs_and_excludes_exists(name: str) -> None:
    assert {*EFFECTS[name].needs, *EFFECTS[name].excludes} <= EFFECTS.keys() - {name}


def test_declared_events_are_events_of_the_plant() -> None:
    kinds = set(re.findall(r"``(\w+)``", (Event.__doc__ or "").partition("parcel:")[0]))
    assert {kind for effect in EFFECTS.values() for kind in effect.events} <= kinds


def test_effects_with_a_place_in_the_ladder_come_first_and_in_its_order() -> None:
    places = [effect.fidelity_rank for effect in EFFECTS.values()]
    ordered = [place for place in places if place is not None]
    assert places[: len(ordered)] == sorted(ordered)
    assert len(set(ordered)) == len(ordered)


def test_the_page_has_what_every_effect_declares() -> None:
    rows = [
        "| " + " | ".join([f"`{one['name']}`", *(_cell(one[key]) for key in COLUMNS)]) + " |"
        for one in declared()
    ]
    text = PAGE.read_text(encoding="utf-8")
    table = text[text.index("| effect |") :].partition("\n\n")[0].splitlines()
    assert table[2:] == rows


COLUMNS = ("states", "events", "messages", "needs", "excludes", "solvers")


def _cell(words: list[str] | None) -> str:
    if words is None:
        return "all"
    return ", ".join(words) or "–"
