"""Numbers by tick and place, held to Philox written out again from its publication."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from bus.random_streams import CounterStream, rng

_MULTIPLIERS = (0xD2E7470EE14C6C93, 0xCA5A826395121157)
_WEYL = (0x9E3779B97F4A7C15, 0xBB67AE8584CAA73B)
_MASK = 2**64 - 1


def philox(counter: tuple[int, int, int, int], key: tuple[int, int]) -> tuple[int, int, int, int]:
    """Ten rounds of Philox 4x64, after Salmon et al. 2011, section 4."""
    for _ in range(10):
        first, second = counter[0] * _MULTIPLIERS[0], counter[2] * _MULTIPLIERS[1]
        counter = (
            (second >> 64) ^ counter[1] ^ key[0],
            second & _MASK,
            (first >> 64) ^ counter[3] ^ key[1],
            first & _MASK,
        )
        key = ((key[0] + _WEYL[0]) & _MASK, (key[1] + _WEYL[1]) & _MASK)
    return counter


def all_of(m: int) -> NDArray[np.int64]:
    return np.arange(m)


def test_the_generator_written_here_gives_the_authors_known_answer() -> None:
    answer = (0x16554D9ECA36314C, 0xDB20FE9D672D0FDC, 0xD7E772CEE186176B, 0x7E68B68AEC7BA23B)
    assert philox((0, 0, 0, 0), (0, 0)) == answer


@given(
    st.integers(0, 2**63 - 1), st.integers(0, 2**40), st.lists(st.integers(0, 400), min_size=1, max_size=5)
)
def test_a_draw_is_philox_at_the_counter_that_tick_and_place_name(
    seed: int, tick: int, places: list[int]
) -> None:
    draws = CounterStream(seed, "purpose", np.array(places))
    a, b = draws._philox.state["state"]["key"].tolist()
    expected = [(philox((p // 4 + 1, tick, 0, 0), (a, b))[p % 4] >> 11) * 2.0**-53 for p in places]
    assert draws.uniform(tick).tolist() == expected


@given(st.sets(st.integers(0, 99), min_size=1), st.lists(st.integers(0, 50), min_size=1, max_size=4))
def test_it_does_not_matter_who_draws_how_many_places_in_which_order(
    places: set[int], ticks: list[int]
) -> None:
    some = np.array(sorted(places))
    few, many = CounterStream(3, "purpose", some), CounterStream(3, "purpose", all_of(100))
    for tick in ticks:
        assert few.uniform(tick).tobytes() == many.uniform(tick)[some].tobytes()


def test_seeds_purposes_and_ticks_draw_different_numbers() -> None:
    drawn = [
        CounterStream(seed, purpose, all_of(50)).uniform(tick).tolist()
        for seed, purpose, tick in ((0, "a", 0), (1, "a", 0), (0, "b", 0), (0, "a", 1))
    ]
    assert len({number for numbers in drawn for number in numbers}) == 200
    assert rng(0, "a").random() not in drawn[0]
