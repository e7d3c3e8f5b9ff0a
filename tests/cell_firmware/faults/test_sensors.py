"""Presence sensors that are stuck, wrong now and then, or late."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import binom

from bus.lattice import Lattice
from cell_firmware.effects.base import ShardContext
from cell_firmware.firmware import Inputs
from tests.cell_firmware.faults.instances import instances

LATTICE = Lattice((0, column) for column in range(6))
SENSORS = 3
EVERY = slice(None)


def readings(
    ticks: int,
    fault: dict[str, Any],
    *,
    cells: NDArray[np.int64] | None = None,
    levels: bool = True,
    **times: int,
) -> tuple[NDArray[np.bool_], NDArray[np.float64], NDArray[np.bool_], NDArray[np.float64], int]:
    """Bits and levels ``(ticks, n, sensors)`` as they are and as they are read; and how many bits are counted wrong."""
    chance = np.random.default_rng(5)
    own = np.arange(6) if cells is None else cells
    level = chance.random((ticks, 6, SENSORS))[:, own]
    bits = level > 0.5
    site = ShardContext(own, SENSORS, None, 3, levels=levels)
    (one,) = instances(LATTICE, fault, seed=3, **times)
    stages = list(one.fault.input_filters(site, LATTICE, one))
    filtered = [
        Inputs(bits[tick].copy(), level=level[tick].copy() if levels else None) for tick in range(ticks)
    ]
    for tick in range(ticks):
        for stage in stages:
            filtered[tick] = stage.apply(tick, filtered[tick], EVERY)
    said = np.array([one.presence for one in filtered])
    levels_said = np.array([one.level for one in filtered]) if levels else np.zeros(0)
    wrong = sum(stage.counters[f"faults.{fault['kind']}.wrong".removeprefix("faults.")] for stage in stages)
    return bits, level, said, levels_said, wrong


@pytest.mark.parametrize("value", [0, 1])
def test_a_stuck_sensor_says_one_thing_and_its_cell_s_others_what_is_so(value: int) -> None:
    fault = {"kind": "sensor_stuck", "value": value, "cells": ((0, 1), (0, 4)), "sensor": 2}
    bits, level, said, levels, wrong = readings(30, fault, first=10, end=20)
    expected, expected_level = bits.copy(), level.copy()
    expected[10:20, [1, 4], 2], expected_level[10:20, [1, 4], 2] = bool(value), value
    assert (said == expected).all()
    assert (levels == expected_level).all()
    assert wrong == (said ^ bits).sum() > 0


def test_readings_are_flipped_at_the_requested_rate_and_the_same_for_every_partition() -> None:
    fault = {"kind": "sensor_flip", "rate": 0.2, "share": 1.0}
    bits, level, said, levels, wrong = readings(400, fault)
    flipped = said ^ bits
    assert binom.ppf(1e-4, flipped.size, 0.2) <= flipped.sum() <= binom.ppf(1 - 1e-4, flipped.size, 0.2)
    assert wrong == flipped.sum()
    assert (levels == np.where(flipped, 1.0 - level, level)).all()
    for cells in (np.array([0, 1, 2]), np.array([3, 5]), np.array([4])):
        _, _, part, _, _ = readings(400, fault, cells=cells)
        assert (part == said[:, cells]).all()


def test_a_delayed_sensor_says_what_it_said_so_many_ticks_before_the_fault_s_first_tick_or_not() -> None:
    fault = {"kind": "sensor_delay", "ticks": 4, "cell": (0, 3)}
    bits, level, said, levels, wrong = readings(30, fault, first=10, end=20)
    expected, expected_level = bits.copy(), level.copy()
    expected[10:20, 3], expected_level[10:20, 3] = bits[6:16, 3], level[6:16, 3]
    assert (said == expected).all()
    assert (levels == expected_level).all()
    assert wrong == (said ^ bits).sum() > 0
    bits, level, said, levels, _ = readings(30, fault)
    assert (levels[:4, 3] == level[0, 3]).all()
    bits, _, said, _, _ = readings(30, fault, levels=False)
    assert (said[:4, 3] == bits[0, 3]).all(), "before the run there is nothing: what was said first"
    assert (said[4:, 3] == bits[:-4, 3]).all()
    assert not list(
        instances(LATTICE, fault)[0].fault.input_filters(
            ShardContext(np.array([0]), 1, None, 0), LATTICE, instances(LATTICE, fault)[0]
        )
    )
