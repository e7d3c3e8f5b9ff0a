"""What faults of cells cost: a shard's step while each of them acts, acts elsewhere, and is over, beside one without.

``python tests/benchmarks/plant/faults_cost.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from pydantic import TypeAdapter

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from bus.fault import FaultInstance, FaultSpec
from bus.lattice import NO_TICK_LIMIT, Lattice
from bus.partition import Partition
from cell_firmware.board_presets import BOARDS
from cell_firmware.build import CellFaults, MotorFacts, build_controller
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.registry import CellEffects
from cell_firmware.faults.base import CellFault
from cell_firmware.firmware import Cells
from cell_firmware.loader import load
from cell_firmware.shard import FAULTS, Shard
from cell_firmware.specs import CellsSpec
from deploy.faults.registry import Fault

ROWS, COLUMNS, SHARDS = 50, 40, 2
BUDGET_S = 0.05
HERE = tuple((row, column) for row in range(ROWS // SHARDS) for column in range(0, COLUMNS, 10))
THERE = tuple((ROWS - 1, column) for column in range(COLUMNS))
KINDS: tuple[dict[str, Any], ...] = (
    {"kind": "hang"},
    {"kind": "slow_clock", "factor": 0.5},
    {"kind": "sensor_flip", "rate": 0.1},
    {"kind": "sensor_delay", "ticks": 4},
    {"kind": "link_down"},
    {"kind": "link_loss", "probability": 0.1},
    {"kind": "link_loss", "probability": 0.1, "burst_ticks": 4.0},
    {"kind": "link_delay", "between_ticks": (0, 4)},
    {"kind": "link_reorder", "probability": 0.1, "ticks": 2},
    {"kind": "link_corrupt", "probability": 0.1},
    {"kind": "link_bandwidth", "messages_per_s": 100.0, "queue": 4},
    {"kind": "babble"},
    {"kind": "lie", "mode": "random"},
)
METHOD = f"""\
Method. heat_diffusion on {ROWS} x {COLUMNS} cells, one of {SHARDS} shards, steps of Shard.step in this process,
processor time. "behavioural": without motors or effects; "board": all effects of the board hc11, serial lines byte
by byte. Beside it, taking turns: the same with one fault that acts in every tick on a tenth of the shard's cells
("acts"), on cells of the other shard alone ("elsewhere"), or in the third and fourth tick alone ("over"). Figures:
microseconds a step, and its time over that of the step without faults, medians of {{turns}} turns.
"""
COLUMNS_SHOWN = ("acts", "elsewhere", "over")


class Side:
    """A shard, and the fault of its scene, if there is one."""

    def __init__(self, effects: dict[str, Any], table: dict[str, Any] | None, when: str = "acts") -> None:
        lattice = Lattice((row, column) for row in range(ROWS) for column in range(COLUMNS))
        spec, partition = CellsSpec(firmware="heat_diffusion"), Partition.even(lattice, SHARDS)
        enabled, faults = CellEffects.model_validate(effects), None
        if table is not None:
            adapter: TypeAdapter[FaultSpec] = TypeAdapter(Fault)
            fault = adapter.validate_python({**table, "cells": THERE if when == "elsewhere" else HERE})
            assert isinstance(fault, CellFault)
            times = (2, 4) if when == "over" else (0, NO_TICK_LIMIT)
            faults = CellFaults(
                lattice, (FaultInstance(0, fault, fault.affected_cells(lattice, 1, 0), *times),), 1
            )
        clocks = None if enabled.clock is None else enabled.clock.clocks(lattice, spec.period_ns, 1)
        motors = MotorFacts(12.0, 1.2) if effects else None
        controller = build_controller(load(spec), spec, enabled, motors, clocks, faults=faults, live=True)
        site = ShardContext(
            partition.cells(0),
            1,
            controller.link_type,
            1,
            said=controller.message_type,
            tick_ns=spec.period_ns if clocks is None else clocks.clocks.window_ns,
            clocks=None if clocks is None else clocks.clocks.take(partition.cells(0)),
        )
        stages = enabled.input_filters(site)
        if faults is not None:
            stages[FAULTS] = faults.stages(site)
        cells = Cells.of(lattice, np.zeros((len(lattice), 2)), spec.period_s)
        injected = () if faults is None else faults.injected
        self.shard = Shard(controller, cells, partition, 0, stages, injected)
        self.there = np.zeros((len(self.shard), 1), dtype=np.bool_)
        self.travel = np.zeros((len(self.shard), 2))
        self.tick = 0

    def step_s(self, budget_s: float) -> float:
        """Processor time of a step, the mean of as many as the budget has."""
        began, steps = time.process_time(), 0
        while (spent := time.process_time() - began) < budget_s:
            self.shard.step(self.tick, self.there.copy(), self.travel)
            self.tick, steps = self.tick + 1, steps + 1
        return spent / steps


def main() -> None:
    """Print the method and the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=5)
    turns: int = parser.parse_args().turns
    print(METHOD.format(turns=turns))
    board = {name: dict(table) for name, table in BOARDS["hc11"].items()}
    for cells, effects in {"behavioural": {}, "board": board}.items():
        bare = Side(effects, None)
        bare.step_s(BUDGET_S)
        print(f"{cells + ':':24s} {1e6 * bare.step_s(BUDGET_S):8.0f} us without faults")
        for table in KINDS:
            shown = f"{table['kind']}{', bursts' if 'burst_ticks' in table else ''}"
            figures = [_against(bare, Side(effects, table, when), turns) for when in COLUMNS_SHOWN]
            columns = (
                f"{name} {step_us:6.0f} us, {ratio:5.2f}"
                for name, (step_us, ratio) in zip(COLUMNS_SHOWN, figures, strict=True)
            )
            print(f"  {shown:22s} {'   '.join(columns)}")


def _against(bare: Side, side: Side, turns: int) -> tuple[float, float]:
    """Return microseconds a step, and the ratio to those of a shard without faults."""
    side.step_s(BUDGET_S / 4)
    times = [(bare.step_s(BUDGET_S), side.step_s(BUDGET_S)) for _ in range(turns)]
    return 1e6 * median(own for _, own in times), median(own / reference for reference, own in times)


if __name__ == "__main__":
    main()
