"""Links that lose, cut, delay, repeat, reorder and throttle what they carry."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from pydantic import ValidationError
from scipy.stats import binom

from bus.lattice import Lattice
from cell_firmware.faults.kinds.link_loss import LinkLossFault
from tests.cell_firmware.effects.links import received_on
from tests.cell_firmware.faults.instances import instances

Grid, Run = Callable[..., Lattice], Callable[..., Any]
ALL = {"share": 1.0}
PERIOD_S = 0.004096


def run_fault(
    grid: Grid, run: Run, ticks: int, fault: dict[str, Any], *, size: tuple[int, int] = (1, 2), **how: Any
) -> tuple[NDArray[np.int64], dict[str, int]]:
    """The tick of what each link brought, ``(ticks, links)``, and what the fault counted, by its own names."""
    lattice = grid(*size)
    times = {name: how.pop(name) for name in ("first", "end") if name in how}
    received, counted = received_on(lattice, run, ticks, faults=instances(lattice, fault, **times), **how)
    kind = f"faults.{fault['kind']}."
    return received, {name.removeprefix(kind): number for name, number in counted.items() if number}


def likely(count: int, of: int, share: float) -> bool:
    return bool(binom.ppf(1e-4, of, share) <= count <= binom.ppf(1 - 1e-4, of, share))


def test_a_link_that_is_down_brings_nothing_from_its_first_tick_to_its_last(grid: Grid, run: Run) -> None:
    fault = {"kind": "link_down", "cell": (0, 0), "side": "east", "direction": "out"}
    received, counted = run_fault(grid, run, 10, fault, first=3, end=6)
    east, west = received.T  # what 0,0 receives of 0,1, and vice versa
    assert east.tolist() == [-1, *range(9)]
    assert west.tolist() == [-1, 0, 1, -1, -1, -1, 5, 6, 7, 8]
    assert counted == {"lost": 3}


def test_a_partition_cuts_the_links_across_its_line_and_no_others(grid: Grid, run: Run) -> None:
    lattice = grid(4, 3, missing=[(1, 1)])
    received, counted = received_on(
        lattice, run, 6, faults=instances(lattice, {"kind": "partition", "row": 1})
    )
    cell, side = np.nonzero(lattice.neighbours >= 0)
    across = ((lattice.rows[cell] == 1) & (side == 0)) | ((lattice.rows[cell] == 2) & (side == 2))
    across &= lattice.columns[cell] != 1
    assert ((received < 0).all(axis=0) == across).all()
    assert counted["faults.partition.lost"] == 5 * across.sum() == 5 * 4


def test_messages_are_lost_at_the_requested_rate_drawn_by_fault_and_number(grid: Grid, run: Run) -> None:
    fault = {"kind": "link_loss", "probability": 0.07, **ALL}
    received, counted = run_fault(grid, run, 30, fault, size=(12, 12))
    lost = int((received[1:] < 0).sum())
    assert likely(lost, received[1:].size, 0.07)
    assert counted == {"lost": lost}
    lattice = grid(12, 12)
    second = instances(lattice, {"kind": "sensor_flip", "rate": 0.0, **ALL}, fault)
    other, _ = received_on(lattice, run, 30, faults=second)
    assert likely(int(((received < 0) & (other < 0))[1:].sum()), received[1:].size, 0.07**2)


@pytest.mark.parametrize(("share", "length"), [(0.1, 8.0), (0.4, 2.5)])
def test_bursts_have_the_share_and_the_mean_length_of_gilbert_s_chain(
    share: float, length: float, grid: Grid, run: Run
) -> None:
    fault = {"kind": "link_loss", "probability": share, "burst_ticks": length, **ALL}
    received, _ = run_fault(grid, run, 301, fault, size=(10, 10), first=1)
    bad = received[1:] < 0
    bursts, ends = np.diff(bad.astype(int), axis=0) > 0, np.diff(bad.astype(int), axis=0) < 0
    # a bad tick is the last of its burst with probability 1 / length, whatever was before: a geometric law
    assert likely(int(ends.sum()), int(bad[:-1].sum()), 1.0 / length)
    assert likely(int(bursts.sum()), int((~bad[:-1]).sum()), share / (1.0 - share) / length)
    # correlation along a link leaves fewer independent ticks: the factor is the chain's own
    memory = 1.0 - 1.0 / length - share / (1.0 - share) / length
    spread = np.sqrt(share * (1.0 - share) * (1.0 + memory) / (1.0 - memory) / bad.size)
    assert abs(bad.mean() - share) < 4.0 * spread
    assert likely(int(bad[0].sum()), bad.shape[1], share), "it begins as it goes on"


@pytest.mark.parametrize(
    ("settings", "rule"),
    [
        ({"probability": 1.0, "burst_ticks": 3.0}, "probability below 1"),
        ({"probability": 0.9, "burst_ticks": 8.0}, r"at least probability / \(1 - probability\), 9, not 8"),
        ({"probability": 0.5, "burst_ticks": 0.5}, "burst_ticks"),
    ],
)
def test_bursts_that_no_chain_has_are_refused(settings: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValidationError, match=rule):
        LinkLossFault.model_validate({**ALL, **settings})


def test_delayed_messages_arrive_when_due_also_after_the_end_of_the_fault(grid: Grid, run: Run) -> None:
    fault = {"kind": "link_delay", "ticks": 3, "cell": (0, 0), "side": "east", "direction": "in"}
    received, counted = run_fault(grid, run, 16, fault, first=4, end=9, every=2)
    # sent in even ticks, received in odd ones; those of 4, 6 and 8 (ticks 5, 7) come in 8 and 10, and the rest at once
    assert received[:, 0].tolist() == [-1, 0, -1, 2, -1, -1, -1, -1, 4, 8, 6, 10, -1, 12, -1, 14]
    assert counted == {"delayed": 2}
    assert received[1::2, 1].tolist() == list(range(0, 16, 2)), "the other direction is as it was"


def test_a_message_in_flight_when_the_delay_ends_is_overtaken_by_a_newer_one(grid: Grid, run: Run) -> None:
    received, counted = run_fault(grid, run, 12, {"kind": "link_delay", "ticks": 2, **ALL}, first=4, end=7)
    assert received[:, 0].tolist() == [-1, 0, 1, 2, -1, -1, 3, 6, 7, 8, 9, 10]
    assert counted == {"delayed": 6, "overtaken": 4}


def test_a_duplicate_comes_a_tick_later_where_nothing_newer_does(grid: Grid, run: Run) -> None:
    always = {"kind": "link_duplicate", "probability": 1.0, **ALL}
    received, counted = run_fault(grid, run, 9, always, every=3, end=5)
    assert received[:, 0].tolist() == [-1, 0, 0, -1, 3, 3, -1, 6, -1]
    assert counted == {"duplicated": 4}
    received, counted = run_fault(grid, run, 9, always)
    assert received[:, 0].tolist() == [-1, *range(8)]
    assert counted == {"overtaken": 14}
    received, counted = run_fault(grid, run, 400, {**always, "probability": 0.2}, size=(6, 6), every=2)
    sent = int((received[1:-1:2] >= 0).sum())
    assert likely(counted["duplicated"], sent, 0.2)


@pytest.mark.parametrize("ticks", [1, 3])
def test_what_is_held_back_comes_after_what_was_sent_later(ticks: int, grid: Grid, run: Run) -> None:
    fault = {"kind": "link_reorder", "probability": 0.1, "ticks": ticks, **ALL}
    received, counted = run_fault(grid, run, 300, fault, size=(5, 5))
    tick, link = np.nonzero(received >= 0)
    late = tick - 1 - received[tick, link]
    assert set(late.tolist()) == {0, ticks}
    held = counted["reordered"]
    assert likely(held, 299 * received.shape[1], 0.1)
    still = held - int((late == ticks).sum())
    assert 0 <= still <= ticks * received.shape[1]
    # a late one was alone in its tick, or took the place of a newer one
    empty = int((received[1:] < 0).sum())
    assert empty + int((late == ticks).sum()) == held + counted["replaced"]


def test_what_is_held_back_when_the_fault_ends_still_comes(grid: Grid, run: Run) -> None:
    fault = {"kind": "link_reorder", "probability": 1.0, "ticks": 2, **ALL}
    received, counted = run_fault(grid, run, 9, fault, first=2, end=4)
    assert received[:, 0].tolist() == [-1, 0, -1, -1, 1, 2, 5, 6, 7]
    assert counted == {"reordered": 4, "replaced": 4}


@pytest.mark.parametrize(
    ("rate", "queue", "burst"), [(100.0, 0, 1), (60.5, 3, 1), (122.0, 2, 5), (300.0, 0, 1)]
)
def test_a_throttled_link_brings_exactly_what_its_bucket_lets_through(
    rate: float, queue: int, burst: int, grid: Grid, run: Run
) -> None:
    """Against a bucket in whole numbers and a list for a queue: as many tokens a tick as the rate times the period."""
    fault = {"kind": "link_bandwidth", "messages_per_s": rate, "queue": queue, "burst": burst, **ALL}
    received, counted = run_fault(grid, run, 400, fault, end=380)
    unit = 1_000 * 1_000_000_000
    gain, tokens = round(rate * 1_000) * 4_096_000, burst * unit
    waits: list[int] = []
    expected, waited, lost = [], 0, 0
    for tick in range(400):
        if tick >= 380:
            lost, waits = lost + len(waits), []
            expected.append(tick - 1)
            continue
        tokens = min(tokens + gain, burst * unit)
        waits += [tick - 1] if tick else []
        word = -1
        if waits and tokens >= unit:
            word, tokens = waits.pop(0), tokens - unit
            waited += word != tick - 1
        expected.append(word)
        if len(waits) > queue:
            waits.pop(0)
            lost += 1
    assert received[:, 0].tolist() == received[:, 1].tolist() == expected
    names = {"waited": 2 * waited, "lost": 2 * lost}
    assert counted == {name: number for name, number in names.items() if number}


def test_faults_act_after_one_another_in_the_scene_s_order(grid: Grid, run: Run) -> None:
    late, cut = {"kind": "link_delay", "ticks": 2, **ALL}, {"kind": "link_down", **ALL, "first": 0, "end": 5}
    lattice = grid(1, 2)
    delayed_first, _ = received_on(lattice, run, 9, faults=instances(lattice, late, cut))
    cut_first, _ = received_on(lattice, run, 9, faults=instances(lattice, cut, late))
    assert delayed_first[:, 0].tolist() == [-1, -1, -1, -1, -1, 2, 3, 4, 5]
    assert cut_first[:, 0].tolist() == [-1, -1, -1, -1, -1, -1, -1, 4, 5]
