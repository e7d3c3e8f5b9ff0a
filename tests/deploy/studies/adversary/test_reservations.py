"""``reserve_path`` and ``route`` under one fault anywhere in one reservation: one parcel without physics, no plant."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from cell_firmware.protocols.route import Route
from cell_firmware.tiles.messages import ahead_by
from deploy.lab.lab import Lab
from deploy.studies.adversary.check import world_of
from deploy.studies.adversary.sample import sample
from deploy.studies.adversary.search import SearchResult, search
from deploy.studies.adversary.spec import Adversary, Kind
from deploy.studies.adversary.world import World
from tests.deploy.studies.adversary.tile_parcel import (
    PERIOD_S,
    SIDE,
    OneLabelled,
    OneParcel,
    ParcelOverTiles,
    Passing,
    PlainVersions,
    TwoAtOnce,
    parameters,
    with_a_second_exit,
)

RESERVATION = (18, 74)
"""Ticks from the first decision about the parcel to the end of the reservation, in the run without faults."""

HEIR_TICKS = 70
"""Ticks after a death in which the heir takes over and decides."""


def _lab(firmware: type, tiles: int = 2, **options: Any) -> Lab:
    given = (with_a_second_exit if issubclass(firmware, Route) else parameters)(tiles)
    return Lab(firmware, (SIDE, tiles * SIDE), parameters=given, period_s=PERIOD_S, check=None, **options)


def _world(firmware: type, adversary: Adversary, **options: Any) -> World:
    lab = _lab(firmware, **options)
    return world_of(lab.scene, adversary, environment=ParcelOverTiles(lab.lattice))


def _searched(firmware: type, *kinds: Kind, tail_ticks: int = 20) -> SearchResult:
    first, end = RESERVATION
    adversary = Adversary(1, end, kinds, delays=(2,), outages=(6,), first_tick=first, tail_ticks=tail_ticks)
    return search(_world(firmware, adversary), limit_s=90.0)


def test_the_parcel_crosses_and_a_lab_under_its_presence_bits_has_the_same_registers() -> None:
    world = _world(OneParcel, Adversary(0))
    assert world.environment is not None
    node, covered, words = world.start(), list[Any](), list[Any]()
    while node.around is not None:
        covered.append(np.array(world.environment.covered(node.around)))
        node, broken = world.step(node, (), len(words))
        words.append(world.transitions.registers(node.states)["firmware.own"])
        assert not broken
    assert RESERVATION[1] < len(words) < 100
    lab = _lab(OneParcel, presence=lambda lab: covered[lab.tick])
    assert np.array_equal(lab.record("own", len(words)), np.array(words))


@pytest.mark.slow
@pytest.mark.parametrize("firmware", [OneParcel, OneLabelled])
@pytest.mark.parametrize("kinds", [("loss", "delay"), ("outage",)])
def test_with_one_message_lost_or_late_or_one_link_cut_anywhere_no_parcel_is_in_two_reservations(
    firmware: type, kinds: tuple[Kind, ...]
) -> None:
    result = _searched(firmware, *kinds)
    assert (result.violation, result.unexplored, result.ticks) == (None, 0, RESERVATION[1])
    assert result.states > 10_000


def test_a_tile_that_takes_a_parcel_too_early_is_found() -> None:
    result = _searched(TwoAtOnce, "loss")
    assert result.violation is not None
    assert result.violation.rule == "a parcel is in one reservation at most"


@pytest.mark.slow
@pytest.mark.parametrize("firmware", [OneParcel, OneLabelled])
@pytest.mark.parametrize("first", range(*RESERVATION, 14))
def test_with_one_death_anywhere_no_parcel_is_in_two_reservations(firmware: type, first: int) -> None:
    end = min(first + 14, RESERVATION[1])
    adversary = Adversary(1, end, ("death",), first_tick=first, tail_ticks=HEIR_TICKS)
    result = search(_world(firmware, adversary), limit_s=110.0)
    assert (result.violation, result.unexplored, result.ticks) == (None, 0, end)
    assert result.states > 5_000


@pytest.mark.slow
def test_with_several_faults_on_three_tiles_no_sampled_schedule_puts_a_parcel_into_two_reservations() -> None:
    kinds: tuple[Kind, ...] = ("loss", "delay", "outage", "death")
    adversary = Adversary(
        4, 110, kinds, delays=(2, 4), outages=(4, 12), at_most={"death": 1}, tail_ticks=HEIR_TICKS
    )
    result = sample(_world(OneLabelled, adversary, tiles=3), 100, limit_s=110.0)
    assert (result.violation, result.limit, result.schedules) == (None, "", 100)


NEAR_THE_WRAP = {"last": (1 << 16) - 18 << 40}
"""A first leader goes on 16 versions after the last one known: with the last but one."""


@pytest.mark.parametrize("begun", [{}, NEAR_THE_WRAP])
def test_a_parcel_is_passed_on_where_versions_wrap(begun: dict[str, int]) -> None:
    world = _world(Passing, Adversary(0, tail_ticks=100), initial_registers=begun)
    result = search(world)
    assert (result.violation, result.limit) == (None, "")
    assert result.states > 85  # the parcel has left


def test_versions_that_are_compared_as_numbers_are_found_where_they_wrap() -> None:
    passed = search(_world(PlainVersions, Adversary(0, tail_ticks=100)))
    assert passed.violation is None
    world = _world(PlainVersions, Adversary(0, tail_ticks=100), initial_registers=NEAR_THE_WRAP)
    violation = search(world).violation
    assert violation is not None
    assert violation.rule == "the tiles get rid of the parcel"


class HeirsResume(OneParcel):
    """Mutant: the heir of a leader that was pushing goes on with its last word."""

    def _lead(self, state: Any, after: Any, own: Any, around: Any, way: Any, *others: Any) -> Any:
        leads, takes_over, *rest = others
        last = ahead_by(np.where(own > 0, own, state["last"]), 16)
        own = np.where(takes_over, last, own)
        return super()._lead(state, after, own, around, way, leads, np.zeros_like(takes_over), *rest)


@pytest.mark.slow
def test_an_heir_that_resumes_is_found() -> None:
    result = _searched(HeirsResume, "death", tail_ticks=HEIR_TICKS)
    assert result.violation is not None
    assert result.violation.rule == "a parcel is in one reservation at most"
    assert result.schedule is not None
    ((_, act),) = result.schedule
    assert act.kind == "death"
