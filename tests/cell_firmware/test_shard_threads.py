"""A shard that several threads step gives the bits of one that a single thread steps."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.effects.registry import CellEffects
from cell_firmware.loader import load
from cell_firmware.specs import CellsSpec
from plant.solvers.thread_pool import ThreadPool
from tests.cell_firmware.test_compiled import HC11, MOTORS, without

LATTICE = Lattice((row, column) for row in range(5) for column in range(7) if (row, column) != (2, 3))
HEAT: dict[str, Any] = {"initial": [{"cell": [0, 0], "speed_m_s": [0.4, -0.2]}], "ttl_periods": 3}
BOARDS: dict[str, tuple[dict[str, Any], str, dict[str, Any], bool]] = {
    "behavioural": ({}, "heat_diffusion", HEAT, False),
    "whole messages by lines": (without("cop"), "heat_diffusion", HEAT, False),
    "lines byte by byte": (without("cop"), "heat_diffusion", HEAT, True),
    "a watchdog": (HC11, "heat_diffusion", HEAT, False),
    "random numbers": ({}, "push_sum", {}, False),
    "drives that are no numbers": ({}, "heat_diffusion", {**HEAT, "diffusion_number": 1e99}, False),
}


@pytest.mark.parametrize("shards", [1, 2])
@pytest.mark.parametrize("name", list(BOARDS))
def test_threads_give_the_same_bits(name: str, shards: int, lockstep: Any) -> None:
    table, firmware, parameters, live = BOARDS[name]
    program = load(CellsSpec(firmware=firmware, parameters=parameters))
    effects = CellEffects.model_validate(table)
    clocks = None if effects.clock is None else effects.clock.clocks(LATTICE, CellsSpec().period_ns, 5)
    motors = MOTORS if effects.encoder is not None else None
    partition = Partition.even(LATTICE, shards)
    one, many = (
        lockstep(program, partition, motors, effects, 3, clocks, live=live, threads=threads)
        for threads in (None, ThreadPool(3))
    )
    draw = np.random.default_rng(4)
    presence, travel = np.zeros((len(LATTICE), 1), dtype=np.bool_), np.zeros((len(LATTICE), 2))
    for tick in range(60):
        if tick == 40:
            for run in (one, many):
                run.retire([(0, 1), (4, 4)])
        presence ^= draw.random(presence.shape) < 0.1
        travel += draw.uniform(-1e-3, 2e-3, travel.shape)
        drives = [run.step(presence.copy(), None if motors is None else travel.copy()) for run in (one, many)]
        assert drives[0].tobytes() == drives[1].tobytes(), tick
        for ours, theirs in zip(one.shards, many.shards, strict=True):
            assert ours.counters() == theirs.counters()
            for (key, values), others in zip(
                ours.registers()[1].items(), theirs.registers()[1].values(), strict=True
            ):
                assert values.tobytes() == others.tobytes(), key
        if tick == 0:
            shared = [len(shard._kernel._shards) for shard in many.shards]
            assert shared == [5] * shards  # three threads, what comes before them, and what comes after
    assert [failure.cell for failure in one.failures] == [failure.cell for failure in many.failures]
