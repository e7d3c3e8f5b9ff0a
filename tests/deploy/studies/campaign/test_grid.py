"""What ``--vary`` and ``--seeds`` understand."""

from __future__ import annotations

import pytest

from deploy.errors import InputError
from deploy.studies.campaign.cases import Axis, combinations, seeds_of, values_of


def test_a_range_includes_its_end_and_every_step_is_the_number_that_was_meant() -> None:
    values = values_of("0:0.5:0.05", "x")
    assert values == (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3, 0.35, 0.4, 0.45, 0.5)
    assert all(isinstance(value, float) for value in values)
    assert values_of("0:1e-3:1e-4", "x")[3] == 0.0003


def test_a_range_whose_steps_pass_by_its_end_stops_before_it() -> None:
    assert values_of("0:0.5:0.2", "x") == (0.0, 0.2, 0.4)


def test_a_range_may_fall_and_of_whole_numbers_stays_whole() -> None:
    assert values_of("3:-1:-2", "x") == (3, 1, -1)
    assert [type(value) for value in values_of("2:4", "x")] == [int] * 3


def test_values_are_toml_with_commas_between_them_and_words_need_no_quotes() -> None:
    assert values_of("[1, 2], [3, 4]", "x") == ([1, 2], [3, 4])
    assert values_of('0.5, true, "a,b"', "x") == (0.5, True, "a,b")
    assert values_of("coast, brake,hold", "x") == ("coast", "brake", "hold")


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("0:1:0", "must not be 0"),
        ("0:1:-0.1", "don't lead from 0 to 1"),
        ("0:1:1e-6", "at most 10,000"),
        ("1,1", "twice"),
        ("", "must have a value"),
        ("1,]", "must be TOML"),
        ("1]\ny=[2", "not of 2"),
    ],
)
def test_what_makes_no_values_is_refused_with_the_option(text: str, why: str) -> None:
    with pytest.raises(InputError, match=rf"^--vary a=.*{why}"):
        values_of(text, "--vary a=" + text.partition("\n")[0])


def test_the_last_key_changes_fastest() -> None:
    axes = [Axis.parse("a=1,2", "x"), Axis.parse("b.0.c=true,false", "x")]
    assert list(combinations(axes)) == [(1, True), (1, False), (2, True), (2, False)]
    assert axes[1].path == ("b", 0, "c")
    assert list(combinations([])) == [()]


def test_seeds_are_so_many_from_the_scenes_own_or_a_range_or_a_list() -> None:
    assert seeds_of("3", 7) == (7, 8, 9)
    assert seeds_of("3:9:3", 7) == (3, 6, 9)
    assert seeds_of("5,2", 7) == (5, 2)


@pytest.mark.parametrize("text", ["0", "-1,2", "0.5,1", "1,true", "a,b"])
def test_what_is_no_seed_is_refused(text: str) -> None:
    with pytest.raises(InputError, match=f"^--seeds {text}: "):
        seeds_of(text, 1)


def test_the_seed_is_no_key_to_vary() -> None:
    with pytest.raises(InputError, match=r"^--vary seed=1,2: .*--seeds"):
        Axis.parse("seed=1,2", "--vary seed=1,2")
