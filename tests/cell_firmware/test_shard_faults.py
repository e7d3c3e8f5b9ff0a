"""Shards on whose cells no fault acts are stepped without its wrappers, and nothing differs but the time it takes."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import pytest

from bus.fault import FaultInstance
from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.board_presets import BOARDS
from cell_firmware.build import MotorFacts
from cell_firmware.compiled import CompiledController
from cell_firmware.effects.registry import CellEffects
from cell_firmware.faults.base import CellFault
from cell_firmware.loader import load
from cell_firmware.specs import CellsSpec
from tests.cell_firmware.faults.instances import instances

TICKS = 90
HC11: dict[str, Any] = {name: dict(table) for name, table in BOARDS["hc11"].items()}
LATTICE = Lattice((0, column) for column in range(6))
TABLES: dict[str, tuple[dict[str, Any], ...]] = {
    "hang": ({"kind": "hang", "cell": (0, 1)},),
    "crash and slow clock": (
        {"kind": "crash", "cell": (0, 0), "first": 20, "end": 50},
        {"kind": "slow_clock", "factor": 0.4, "cell": (0, 1), "first": 35},
    ),
    "reboots": (
        {"kind": "reboot", "cell": (0, 4), "delay_s": 0.02, "first": 30},
        {"kind": "hang", "cell": (0, 5), "first": 60, "end": 70},
    ),
    "a link and a sensor": (
        {"kind": "link_loss", "probability": 0.4, "cell": (0, 1), "side": "west"},
        {"kind": "sensor_flip", "rate": 0.3, "cell": (0, 4)},
    ),
    "damaged messages": ({"kind": "link_corrupt", "probability": 0.5, "bits": 3, "cell": (0, 0)},),
}


def array(lockstep: Any, shards: int, faults: list[FaultInstance[CellFault]], *, live: bool = False) -> Any:
    """Boards in a row that diffuse speeds."""
    program = load(
        CellsSpec(
            firmware="heat_diffusion",
            parameters={"initial": [{"cell": [0, 0], "speed_m_s": [0.4, -0.2]}], "ttl_periods": 3},
        )
    )
    effects = CellEffects.model_validate(HC11)
    assert effects.clock is not None
    clocks = effects.clock.clocks(LATTICE, CellsSpec().period_ns, 5)
    motors = MotorFacts(12.0, 1.2)
    partition = Partition.even(LATTICE, shards)
    return lockstep(program, partition, motors, effects, 3, clocks, faults, live=live)


def step(run: Any, tick: int) -> bytes:
    """A tick in which parcels lie here and there."""
    presence = np.array([[(tick // 7 + cell) % 3 == 0] for cell in range(len(LATTICE))])
    return run.step(presence, np.full((len(LATTICE), 2), 0.001 * tick)).tobytes()


def shown(run: Any) -> tuple[Counter[str], dict[str, dict[tuple[int, ...], bytes]]]:
    """Counters of all shards together, and registers by name and cell."""
    counters, registers = Counter[str](), dict[str, dict[tuple[int, ...], bytes]]()
    for shard in run.shards:
        counters.update(shard.counters())
        cells, values = shard.registers()
        for name, array in values.items():
            rows = zip(cells.tolist(), array, strict=True)
            registers.setdefault(name, {}).update((tuple(cell), row.tobytes()) for cell, row in rows)
    return counters, registers


def compiled(run: Any) -> list[bool]:
    """Whether each shard steps a compiled controller."""
    return [isinstance(shard._controller, CompiledController) for shard in run.shards]


@pytest.mark.parametrize("name", list(TABLES))
def test_faults_of_other_shards_change_nothing_but_what_is_compiled(name: str, lockstep: Any) -> None:
    faults = instances(LATTICE, *({"first": 10, **table} for table in TABLES[name]))
    whole, cut = array(lockstep, 1, faults), array(lockstep, 3, faults)
    acts = {
        "hang": [True, False, False],
        "crash and slow clock": [True, False, False],
        "reboots": [False, False, True],
        "a link and a sensor": [False, False, False],
        "damaged messages": [True, True, True],
    }
    assert compiled(cut) == [not one for one in acts[name]]
    for tick in range(TICKS):
        assert step(whole, tick) == step(cut, tick), tick
        if tick % 30 == 29:
            assert shown(whole) == shown(cut)


@pytest.mark.parametrize("name", list(TABLES))
def test_faults_that_are_injected_are_attached_where_they_act_alone(name: str, lockstep: Any) -> None:
    faults = instances(LATTICE, *({"first": 10, **table} for table in TABLES[name]))
    # the same faults once more, of other cells: a shard that had none gets wrappers for all
    later = instances(LATTICE, *({**table, "cell": (0, 3), "first": 66, "end": 80} for table in TABLES[name]))
    for i, fault in enumerate(later):
        fault.number = len(faults) + i
    whole = array(lockstep, 1, [*faults, *later])
    live = array(lockstep, 3, [], live=True)
    assert compiled(live) == [True, True, True]
    for tick in range(TICKS):
        for fault in (*faults, *later):
            if fault.start_tick == tick:
                for shard, site in zip(live.shards, live.sites, strict=True):
                    shard.inject(fault, site, LATTICE)
        assert step(whole, tick) == step(live, tick), tick
        if tick == 65:
            untouched = {"hang": [1, 2], "crash and slow clock": [1, 2], "reboots": [0, 1]}
            assert [i for i in untouched.get(name, []) if not compiled(live)[i]] == []
    assert shown(whole) == shown(live)
