"""Pieces of the kit on plain numbers, beside what they stand for."""

from __future__ import annotations

import itertools
from typing import Any

import numpy as np
import pytest

from bus.lattice import OPPOSITE, STEPS
from mdms import kit

TRIALS = 300


def test_a_message_is_valid_for_its_time_to_live_and_a_corrupted_count_for_no_longer() -> None:
    assert kit.aged(True, 0, 3) == 3
    assert [kit.aged(False, count, 3) for count in (3, 2, 1, 0, 99, -5)] == [2, 1, 0, 0, 3, 0]


LIMIT = 6
Claims = tuple[list[bool], list[int], list[int], list[tuple[int, int, int]]]


def claims(draw: np.random.Generator) -> Claims:
    """Validity, keys and hops of the four sides; key, distance and side of those that count."""
    valid, keys = draw.integers(0, 2, 4).astype(bool).tolist(), draw.integers(0, 4, 4).tolist()
    hops = draw.integers(-2, LIMIT + 2, 4).tolist()
    good = [s for s in range(4) if valid[s] and hops[s] >= 0 and hops[s] + 1 < LIMIT]
    return valid, keys, hops, [(keys[s], hops[s] + 1, s) for s in good]


def test_the_least_key_is_elected_and_of_its_claims_the_nearest() -> None:
    draw = np.random.default_rng(1)
    for _ in range(TRIALS):
        own, (valid, keys, hops, offers) = int(draw.integers(0, 5)), claims(draw)
        assert kit.elect(own, valid, keys, hops, LIMIT) == min([(own, 0, kit.NOBODY), *offers])


def test_a_gradient_is_one_more_than_the_least_around() -> None:
    draw = np.random.default_rng(2)
    for _ in range(TRIALS):
        valid, _, hops, offers = claims(draw)
        least = min([(LIMIT, kit.NOBODY), *((distance, side) for _, distance, side in offers)])
        assert kit.descend(False, valid, hops, LIMIT) == least
        assert kit.descend(True, valid, hops, LIMIT) == (0, kit.NOBODY)


def test_a_child_points_here_from_one_hop_farther_under_the_same_root() -> None:
    for side in range(4):
        assert kit.is_child(side, 7, 2, 7, 3, OPPOSITE[side])
        assert not kit.is_child(side, 7, 2, 7, 3, side)
        assert not kit.is_child(side, 7, 2, 8, 3, OPPOSITE[side])
        assert not kit.is_child(side, 7, 2, 7, 2, OPPOSITE[side])


def test_sums_are_bounded_and_go_back_from_the_root() -> None:
    assert kit.subtotal(2, (True, False, True, False), (5, 100, 1, 100), 1000) == 8
    assert kit.subtotal(2, (True, True, True, True), (900, 900, -7, 1), 1000) == 1000
    assert kit.broadcast(kit.NOBODY, 8, (1, 2, 3, 4)) == 8
    assert kit.broadcast(2, 8, (1, 2, 3, 4)) == 3


@pytest.mark.parametrize("seed", range(20))
def test_running_sums_bring_the_mass_of_lost_and_overtaken_messages_over_any_wrap(seed: int) -> None:
    draw = np.random.default_rng(seed)
    total = seen = int(kit.MODULUS - draw.integers(0, 50))
    here = arrived = 0
    for share in draw.integers(-40, 60, 50).tolist():
        total, here = kit.pushed(total, share), here + share
        if draw.random() < 0.5:
            arrived, seen = arrived + kit.arrived(total, seen), total
    arrived += kit.arrived(total, seen)
    assert arrived == here


def test_shares_leave_no_unit_behind() -> None:
    for mass, neighbours in itertools.product((-13, -1, 0, 3, 2**53 + 1), range(5)):
        share = kit.share_of(mass, neighbours)
        assert 0 <= mass - neighbours * share - share <= neighbours


def test_of_two_cells_within_two_hops_one_yields() -> None:
    def step(side: int, other: int) -> tuple[int, int]:
        second = (0, 0) if other == 4 else STEPS[other]
        return STEPS[side][0] + second[0], STEPS[side][1] + second[1]

    for side, other in itertools.product(range(4), range(5)):
        row, column = step(side, other)
        if (row, column) != (0, 0):
            assert kit.yields(side, other) == ((row, column) > (0, 0))


def test_a_free_slot_is_one_that_no_known_cell_has() -> None:
    draw = np.random.default_rng(3)
    for _ in range(TRIALS):
        valid = draw.integers(0, 2, 4).astype(bool).tolist()
        near, beyond = draw.integers(0, 18, 4).tolist(), draw.integers(0, 18, (4, 4)).tolist()
        known = [(near[s], s, 4) for s in range(4) if valid[s]]
        known += [(beyond[s][o], s, o) for s in range(4) for o in range(4) if valid[s] and o != OPPOSITE[s]]
        free = [slot for slot in range(16) if slot not in {used for used, _, _ in known}]
        assert kit.free_slot(valid, near, beyond, 16, 0.0) == free[0]
        assert kit.free_slot(valid, near, beyond, 16, 1.0 - 2.0**-53) == free[-1]
        assert {kit.free_slot(valid, near, beyond, 16, i / 99) for i in range(99)} == set(free)
        for slot in range(16):
            moves = any(used == slot and kit.yields(side, other) for used, side, other in known)
            assert kit.has_to_move(slot, valid, near, beyond) == moves


def test_slots_are_tried_on_as_many_cells_as_there_are_within_two_hops() -> None:
    around = {(a + c, b + d) for (a, b), (c, d) in itertools.product(STEPS, (*STEPS, (0, 0)))} - {(0, 0)}
    assert len(around) == kit.MOST_AROUND


@pytest.mark.parametrize("base", [5, kit.PULSES - 1, kit.PULSES // 2])
def test_a_pulse_waits_for_all_neighbours_and_joins_the_farthest_over_any_wrap(base: int) -> None:
    def after(*ahead: int | None) -> int:
        valid: list[Any] = [one is not None for one in ahead]
        heard = [(base + (one or 0)) % kit.PULSES for one in ahead]
        return kit.lead(kit.next_pulse(base, valid, heard), base)

    assert after(0, 1, 0, None) == 1
    assert after(0, -1, 1, None) == 0
    assert after(-1, 3, 7, None) == 7
    assert after(None, None, None, None) == 1
    assert kit.lead(base, (base + 4) % kit.PULSES) == -4


def test_a_neighbour_a_pulse_ahead_still_has_the_value_of_this_one() -> None:
    assert kit.value_at(4, 4, "now", "before") == "now"
    assert kit.value_at(4, 5, "now", "before") == "before"
