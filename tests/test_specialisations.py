"""Specialisations of kernels that tests use: which a run compiles ahead, and that another one is noticed."""

from __future__ import annotations

from pathlib import Path

import pytest

from plant.kernels.common import cache
from tests import specialisations
from tests.plant.scenes import study
from tests.specialisations import SPECIALISATIONS, Watch, chosen, loaded, use

EXACT = "plant.kernels.exact.block.advance_block"


def names(expression: str) -> set[str]:
    return {one.name for one in chosen(expression)}


def test_names_are_unique() -> None:
    assert len({one.name for one in SPECIALISATIONS}) == len(SPECIALISATIONS)


def test_a_tier_compiles_what_its_tests_use_and_no_more() -> None:
    everywhere = {one.name for one in SPECIALISATIONS if one.needed is None}
    slow = {one.name for one in SPECIALISATIONS if one.needed == "slow"}
    assert names("not slow and not system and not kernels") == everywhere
    own = {one.name for one in SPECIALISATIONS} - {one.includes for one in SPECIALISATIONS}
    assert names("not slow") == own - slow
    assert names("slow") == names("") == own
    assert everywhere
    assert slow


def test_the_longest_are_begun_first_and_those_of_the_slow_tier_last() -> None:
    begun = [(one.needed == "slow", -one.seconds) for one in chosen("")]
    assert begun == sorted(begun)


def test_a_specialisation_that_is_not_listed_is_named_once() -> None:
    study()
    (types,) = loaded()[EXACT]
    watch = Watch({name: one for name, one in loaded().items() if name != EXACT})
    (found,) = watch.found()
    assert found.startswith(f"{EXACT}: Surface, ")
    assert types in found
    assert watch.found() == []


def test_one_that_is_listed_is_not_named() -> None:
    study()
    assert Watch(loaded()).found() == []


@pytest.mark.kernels
def test_touching_parcels_call_every_entry_point_of_contacts(monkeypatch: pytest.MonkeyPatch) -> None:
    from plant.kernels.contact import entry

    (contact,) = (one for one in SPECIALISATIONS if one.name == "contact")
    points = {name: point for name, point in vars(entry).items() if hasattr(point, "overloads")}
    called: set[str] = set()

    def noting(name: str, point):  # type: ignore[no-untyped-def]
        def call(*arguments: object) -> object:
            called.add(name)
            return point(*arguments)

        return call

    for name, point in points.items():
        monkeypatch.setattr(entry, name, noting(name, point))
    use(contact)
    assert called == points.keys()


def test_a_note_is_of_one_entry_and_of_the_plants_texts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def notes() -> list[Path]:
        specialisations._texts.cache_clear()
        return [specialisations._note(one) for one in SPECIALISATIONS]

    monkeypatch.setattr(cache, "KERNELS", tmp_path / "kernels")
    (tmp_path / "kernels").mkdir()
    files = tmp_path / "kernels" / "block.py", tmp_path / "plant.py"
    for file in files:
        file.write_text("a = 1\n")
    before = notes()
    assert len(set(before)) == len(before)
    assert notes() == before
    for file in files:
        file.write_text("a = 1  # a comment\n")
        assert not set(notes()) & set(before)
        file.write_text("a = 1\n")
        assert notes() == before
