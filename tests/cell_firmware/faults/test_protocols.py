"""No bundled protocol raises, or drives what is no number, whatever links bring."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.loader import BUNDLED, load
from cell_firmware.scalar_program import PYTHON, ScalarProgram
from cell_firmware.specs import CellsSpec
from tests.cell_firmware.faults.instances import instances

FASTEST = 1e6
ROWS, COLUMNS, TICKS = 8, 12, 120
LEFT, RIGHT = {"columns": (0, 0)}, {"columns": (COLUMNS - 1, COLUMNS - 1)}
FIELD = {"field": {"kind": "uniform", "velocity_m_s": (0.1, 0.0)}}
SPEEDS = {"held": ({**LEFT, "speed_m_s": (0.3, 0.0)}, {**RIGHT, "speed_m_s": (0.0, 0.1)}), "ttl_periods": 5}
TILES = {"lanes": ("e e .", "e e ."), "exits": tuple({"tile": (row, 2), "side": "east"} for row in (0, 1))}
LEGS = ({"to_m": (0.8, 0.4)}, {"turn_rad": 1.0})
PARAMETERS: dict[str, dict[str, Any]] = {
    "align": {"size_m": (0.3, 0.2)},
    "average_consensus": {"values": ({**LEFT, "value": 1.0},), "velocity_m_s": (0.1, 0.0)},
    "heat_diffusion": SPEEDS,
    "hop_gradient": {"goals": ({"cell": (3, 3)},), "speed_m_s": 0.1},
    "laplace": {"held": ({**LEFT, "value": 1.0}, {**RIGHT, "value": 0.0}), "gain_m2_s": 0.01},
    "max_consensus": {"speed_m_s": (0.1, 0.0)},
    "parcel_estimate": {"size_m": (0.3, 0.2), "target_m": (0.5, 0.4)},
    "reserve_path": TILES,
    "route": TILES,
    "distance2_slots": {},
    "push_sum": {"values": ({**LEFT, "value": 1.0},), "velocity_m_s": (0.1, 0.0)},
    "spanning_tree": {"roots": ({"cell": (3, 3)},), "speed_m_s": 0.1},
    "synchroniser": {"values": ({**LEFT, "value": 1.0},), "velocity_m_s": (0.1, 0.0)},
    "stream": {"sources": ({**LEFT, "flow_m2_s": 0.02}, {**RIGHT, "flow_m2_s": -0.02})},
    "hanging_field": {**FIELD, "cells": (), "after_periods": 10},
    "velocity_field": FIELD,
    "virtual_vehicle": {"vehicles": ({"start_m": (0.3, 0.3), "radius_m": 0.2, "legs": LEGS},)},
    "presence_field": {**FIELD, "reach": 2, "ttl_periods": 3},
    "wave": {**SPEEDS, "damping": 0.2},
}
HOSTILE: tuple[dict[str, Any], ...] = (
    {"kind": "link_loss", "share": 0.3, "probability": 0.3, "burst_ticks": 4.0},
    {"kind": "link_duplicate", "share": 0.3, "probability": 0.5},
    {"kind": "link_delay", "share": 0.3, "between_ticks": (0, 6), "ordered": False},
    {"kind": "link_reorder", "share": 0.3, "probability": 0.3, "ticks": 3},
    {"kind": "link_corrupt", "share": 1.0, "probability": 0.2, "bits": 1},
    {"kind": "link_corrupt", "share": 0.4, "probability": 0.3, "bits": 9},
    {"kind": "babble", "cells": ((2, 3), (5, 9))},
    {"kind": "lie", "share": 0.2, "mode": "random"},
    {"kind": "lie", "share": 0.2, "mode": "factor", "by": -3.0},
    {"kind": "reboot", "share": 0.2, "first": 40, "end": 50},
    {"kind": "sensor_flip", "share": 1.0, "rate": 0.1},
)


@pytest.mark.parametrize("name", sorted(BUNDLED))
def test_a_bundled_protocol_survives_links_that_do_all_that_links_can_do(
    name: str, grid: Callable[..., Lattice], lockstep: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(PYTHON, "1")  # scalar programs: no test of this folder waits for a compiler
    firmware = load(CellsSpec(firmware=name, parameters=PARAMETERS[name]))
    slow = isinstance(firmware, ScalarProgram)
    lattice, ticks = (grid(6, 10), 56) if slow else (grid(ROWS, COLUMNS), TICKS)
    firmware.check(lattice)
    faults = instances(lattice, *HOSTILE, end=3 * ticks // 4)
    steps = lockstep(firmware, Partition.even(lattice, 1), seed=4, faults=faults)
    place = np.stack((lattice.columns, lattice.rows), axis=1) * 0.1
    for tick in range(ticks):
        near = np.hypot(*(place - (0.3 + 0.001 * tick, 0.3)).T) < 0.15
        drive = steps.step(near[:, None])
        assert steps.failures == [], (tick, steps.failures[0].problem)
        assert np.isfinite(drive).all()
        # what a plant can still integrate: nonsense it may be, but no number near the largest there is
        assert abs(drive).max() < FASTEST, tick
    counted = steps.shards[0].counters()
    if firmware.message is not None:
        assert counted["faults.link_corrupt.corrupted"] > 0
