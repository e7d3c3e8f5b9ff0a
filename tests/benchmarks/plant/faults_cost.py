"""What faults of cells cost: a shard's step with each of them acting, beside one without any.

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
from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.build import CellFaults, build_controller
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.registry import CellEffects
from cell_firmware.faults.base import CellFault
from cell_firmware.firmware import Cells
from cell_firmware.loader import load
from cell_firmware.shard import FAULTS, Shard
from cell_firmware.specs import CellsSpec
from deploy.faults.registry import Fault

ROWS, COLUMNS = 25, 40
BUDGET_S = 0.1
SHARE: dict[str, Any] = {"share": 0.1}
KINDS: tuple[dict[str, Any], ...] = (
    {"kind": "hang", **SHARE},
    {"kind": "slow_clock", "factor": 0.5, **SHARE},
    {"kind": "sensor_flip", "rate": 0.1, **SHARE},
    {"kind": "sensor_delay", "ticks": 4, **SHARE},
    {"kind": "link_down", **SHARE},
    {"kind": "link_loss", "probability": 0.1, **SHARE},
    {"kind": "link_loss", "probability": 0.1, "burst_ticks": 4.0, **SHARE},
    {"kind": "link_delay", "between_ticks": (0, 4), **SHARE},
    {"kind": "link_reorder", "probability": 0.1, "ticks": 2, **SHARE},
    {"kind": "link_corrupt", "probability": 0.1, **SHARE},
    {"kind": "link_bandwidth", "messages_per_s": 100.0, "queue": 4, **SHARE},
    {"kind": "babble", **SHARE},
    {"kind": "lie", "mode": "random", **SHARE},
    {"kind": "partition", "row": ROWS // 2},
)
METHOD = f"""\
Method. heat_diffusion on {ROWS} x {COLUMNS} cells without motors or effects, one shard, steps of Shard.step in this
process, processor time. Beside it, taking turns: the same with one fault that acts in every tick, on a tenth of the
cells drawn by the seed. Ratio: a step's time over that of the step without faults, median of {{turns}} turns; least and
greatest ratio of a turn in brackets. "a fault to come": one that begins after the last tick.
"""


class Side:
    """A shard, and the fault of its scene, if there is one."""

    def __init__(self, table: dict[str, Any] | None, first: int = 0) -> None:
        lattice = Lattice((row, column) for row in range(ROWS) for column in range(COLUMNS))
        spec, partition = CellsSpec(firmware="heat_diffusion"), Partition.even(lattice, 1)
        faults: CellFaults | None = None
        if table is not None:
            adapter: TypeAdapter[FaultSpec] = TypeAdapter(Fault)
            fault = adapter.validate_python(table)
            assert isinstance(fault, CellFault)
            faults = CellFaults(
                lattice, (FaultInstance(0, fault, fault.affected_cells(lattice, 1, 0), first),), 1
            )
        controller = build_controller(load(spec), spec, CellEffects(), None, faults=faults)
        site = ShardContext(
            partition.cells(0),
            1,
            controller.link_type,
            1,
            said=controller.message_type,
            tick_ns=spec.period_ns,
        )
        stages = {} if faults is None else {FAULTS: faults.stages(site)}
        cells = Cells.of(lattice, np.zeros((len(lattice), 2)), spec.period_s)
        self.shard = Shard(controller, cells, partition, 0, stages)
        self.there = np.zeros((len(lattice), 1), dtype=np.bool_)
        self.tick = 0

    def step_s(self, budget_s: float) -> float:
        """Processor time of a step, the mean of as many as the budget has."""
        began, steps = time.process_time(), 0
        while (spent := time.process_time() - began) < budget_s:
            self.shard.step(self.tick, self.there.copy())
            self.tick, steps = self.tick + 1, steps + 1
        return spent / steps


def main() -> None:
    """Print the method and the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=5)
    turns: int = parser.parse_args().turns
    print(METHOD.format(turns=turns))
    bare = Side(None)
    sides = {"none": Side(None), "a fault to come": Side(dict(KINDS[5]), first=1 << 40)}
    for table in KINDS:
        sides[f"{table['kind']}{', bursts' if 'burst_ticks' in table else ''}"] = Side(dict(table))
    bare.step_s(BUDGET_S)
    for name, side in sides.items():
        side.step_s(BUDGET_S / 4)
        times = [(bare.step_s(BUDGET_S), side.step_s(BUDGET_S)) for _ in range(turns)]
        ratios = [own / reference for reference, own in times]
        step_us = 1e6 * median(own for _, own in times)
        print(f"{name:24s} {step_us:8.0f} us  {median(ratios):5.2f} ({min(ratios):.2f} to {max(ratios):.2f})")


if __name__ == "__main__":
    main()
