"""Messages that take their time, held to a queue a link written out in plain Python."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.stats import binom

from bus.lattice import Lattice
from bus.partition import Partition
from bus.random_streams import CounterStream
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.link_delay import LinkDelaySpec
from cell_firmware.effects.link_loss import LinkLossSpec
from cell_firmware.effects.registry import CellEffects
from tests.cell_firmware.effects.links import Stamper, received_on

Grid, Run = Callable[..., Lattice], Callable[..., Any]


def delay(**settings: Any) -> CellEffects:
    return CellEffects(link_delay=LinkDelaySpec(**settings))


@pytest.mark.parametrize("ticks", [0, 1, 5])
def test_a_message_of_tick_k_is_read_in_tick_k_plus_one_plus_the_delay_each_of_them(
    ticks: int, grid: Grid, run: Run
) -> None:
    received, counted = received_on(grid(3, 4), run, 20, delay(ticks=ticks))
    expected = np.maximum(np.arange(20) - 1 - ticks, -1)
    assert (received == expected[:, None]).all()
    assert not counted["link_delay.overtaken"]


def queues(
    lattice: Lattice, ticks: int, bounds: tuple[int, int], ordered: bool, loss: float
) -> tuple[Any, dict[str, int]]:
    """What is received when, and what is counted: a queue a link. Delays and losses are the effects' own draws."""
    low, high = bounds
    links = np.flatnonzero((lattice.neighbours >= 0).ravel())
    delays, losses = CounterStream(9, "link_delay", links), CounterStream(9, "link_loss", links)
    # tick k's numbers are those of the messages that were sent in tick k - 1
    delay_of = [(low + (delays.uniform(k) * (high - low + 1)).astype(int)).tolist() for k in range(ticks)]
    is_lost = [(losses.uniform(k) < loss).tolist() for k in range(ticks)]
    received = np.full((ticks, len(links)), -1)
    overtaken = 0
    for link in range(len(links)):
        due: dict[int, int] = {}
        for sent in (sent for sent in range(ticks - 1) if not is_lost[sent + 1][link]):
            arrival = sent + 1 + delay_of[sent + 1][link]
            arrival = max(arrival, *due.values(), 0) if ordered else arrival
            overtaken += arrival in due.values()
            due[sent] = arrival
        for tick in range(ticks):
            received[tick, link] = max((sent for sent, when in due.items() if when == tick), default=-1)
    return received, {"link_delay.overtaken": overtaken, "link_loss.lost": sum(map(sum, is_lost[1:]))}


@pytest.mark.parametrize("ordered", [True, False])
@pytest.mark.parametrize("bounds", [(0, 1), (2, 6), (0, 9)])
@pytest.mark.parametrize("loss", [0.0, 0.4])
def test_random_delays_act_as_a_queue_a_link_does_and_what_is_lost_holds_nothing_up(
    ordered: bool, bounds: tuple[int, int], loss: float, grid: Grid, run: Run
) -> None:
    lattice = grid(3, 4, missing=[(1, 1)])
    effects = CellEffects(
        link_delay=LinkDelaySpec(between_ticks=bounds, ordered=ordered),
        link_loss=LinkLossSpec(probability=loss),
    )
    received, counted = received_on(lattice, run, 60, effects, seed=9)
    expected, numbers = queues(lattice, 60, bounds, ordered, loss)
    assert (received == expected).all()
    assert {"link_loss.lost": 0, **counted} == numbers


def test_messages_overtake_each_other_only_where_order_is_not_preserved(grid: Grid, run: Run) -> None:
    for ordered in (True, False):
        received, _ = received_on(grid(4, 4), run, 60, delay(between_ticks=(0, 8), ordered=ordered))
        backwards = False
        for link in received.T:
            came = link[link >= 0]
            assert ordered <= bool((np.diff(came) > 0).all())
            backwards = backwards or bool((np.diff(came) < 0).any())
        assert backwards != ordered


def test_every_delay_between_the_bounds_is_as_likely(grid: Grid, run: Run) -> None:
    """Messages so far apart that none meets another."""
    received, counted = received_on(grid(10, 10), run, 12 * 40, delay(between_ticks=(2, 6)), every=12)
    tick, link = np.nonzero(received >= 0)
    lag = tick - received[tick, link] - 1
    assert counted["link_delay.overtaken"] == 0
    assert len(lag) == 40 * 360
    assert set(lag.tolist()) == {2, 3, 4, 5, 6}
    for ticks in range(2, 7):
        assert binom.ppf(1e-4, len(lag), 0.2) <= (lag == ticks).sum() <= binom.ppf(1 - 1e-4, len(lag), 0.2)


@pytest.mark.parametrize("shards", [1, 2])
def test_what_a_cell_sent_before_it_died_still_arrives_when_it_is_due(
    shards: int, grid: Grid, run: Run
) -> None:
    firmware = Stamper()
    partition = Partition.even(grid(1, 2), shards)
    run(firmware, partition, 12, dead={4: [(0, 0)]}, effects=delay(ticks=3))
    west = [firmware.received[tick, 0, 1][3] for tick in range(12)]
    assert west == [-1, -1, -1, -1, 0, 1, 2, 3, -1, -1, -1, -1]


@pytest.mark.parametrize(("ticks", "message"), [(0, "<i8"), (3, None)])
def test_with_nothing_to_delay_there_is_no_stage(ticks: int, message: str | None) -> None:
    site = ShardContext(np.arange(4), 1, message and np.dtype([("a", message)]), 0)
    assert delay(ticks=ticks).input_filters(site) == {"link_delay": ()}


@pytest.mark.parametrize(
    ("settings", "rule"),
    [
        ({}, "give ticks or between_ticks, one of the two"),
        ({"ticks": 1, "between_ticks": (0, 1)}, "give ticks or between_ticks, one of the two"),
        ({"between_ticks": (3, 1)}, "the least delay and then the greatest"),
        ({"ticks": -1}, "ticks"),
        ({"ticks": 1001}, "ticks"),
    ],
)
def test_settings_that_make_no_sense_are_refused(settings: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValidationError, match=rule):
        LinkDelaySpec.model_validate(settings)
