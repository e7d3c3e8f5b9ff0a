"""What a control period of a cell costs, compiled and on arrays.

``python tests/benchmarks/cells/compiled_step.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.board_presets import BOARDS
from cell_firmware.build import MotorFacts, build_controller
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.registry import CellEffects
from cell_firmware.firmware import Cells
from cell_firmware.loader import load
from cell_firmware.shard import Shard
from cell_firmware.specs import CellsSpec

SIZES = (1, 18, 400, 1_000, 10_000, 100_000)
BUDGET_S = 0.3
METHOD = """\
Method. Shard.step of one shard in this process, cells in one row: heat_diffusion, wheels with motors and encoders.
"board": all effects of the board hc11; "live": the same, where faults may be injected, so that serial lines go
byte by byte. "behavioural": a speed loop in floating point, whole messages. Sensor bits
change and wheels turn between steps; that is made beforehand. Compiled and on arrays (the general controller, as with
faults) take turns of {budget} s; a figure is the median over {turns} turns of processor time a step, the ratio the
median of the turns' ratios. The tests hold both to the same bits.
"""


class Side:
    """A shard with its inputs."""

    def __init__(self, effects: dict[str, Any], cells: int, *, compiled: bool, live: bool) -> None:
        lattice = Lattice((0, column) for column in range(cells))
        enabled, spec = CellEffects.model_validate(effects), CellsSpec(firmware="heat_diffusion")
        partition = Partition.even(lattice, 1)
        clocks = None if enabled.clock is None else enabled.clock.clocks(lattice, spec.period_ns, 1)
        controller = build_controller(
            load(spec), spec, enabled, MotorFacts(12.0, 1.2), clocks, live=live, metered=True
        )
        own = None if clocks is None else clocks.clocks.take(partition.cells(0))
        site = ShardContext(partition.cells(0), 1, controller.link_type, 1, clocks=own)
        whole = Cells.of(lattice, np.zeros((cells, 2)), spec.period_s)
        self.shard = Shard(controller, whole, partition, 0, enabled.input_filters(site))
        if not compiled:
            self.shard._controller, self.shard._kernel = self.shard._controller.general, None
        draw = np.random.default_rng(cells)
        self.presence = draw.random((8, cells, 1)) < 0.5
        self.travel = np.cumsum(draw.uniform(-1e-3, 2e-3, (8, cells, 2)), axis=0)
        self.tick = 0

    def step_s(self, budget_s: float) -> float:
        """Processor time of a step, the mean of as many as the budget has."""
        batch = max(1, 4_000 // len(self.shard))
        spent, steps = 0.0, 0
        while spent < budget_s:
            began = time.process_time()
            for _ in range(batch):
                self.shard.step(self.tick, self.presence[self.tick % 8], self.travel[self.tick % 8])
                self.tick += 1
            spent += time.process_time() - began
            steps += batch
        return spent / steps


def measure(
    effects: dict[str, Any], cells: int, turns: int, budget_s: float, *, live: bool
) -> dict[str, float]:
    """Time of a step, µs, compiled and on arrays, and their ratio."""
    both = [Side(effects, cells, compiled=compiled, live=live) for compiled in (True, False)]
    for side in both:
        side.step_s(0.1 * budget_s)
    times = [[side.step_s(budget_s) for side in both] for _ in range(turns)]
    compiled, arrays = (1e6 * median(turn[i] for turn in times) for i in range(2))
    ratio = median(arrays / compiled for compiled, arrays in times)
    return {"cells": cells, "compiled_us": compiled, "arrays_us": arrays, "ratio": ratio}


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=7)
    parser.add_argument("--cells", type=int, action="append", help="only so many; repeatable")
    parser.add_argument("--budget", type=float, default=BUDGET_S, help="processor time of a turn, s")
    parser.add_argument("--json", action="store_true", help="one JSON object")
    asked = parser.parse_args()
    board = {name: dict(table) for name, table in BOARDS["hc11"].items()}
    kinds = {"board": board, "live": board, "behavioural": {}}
    found = {
        kind: [
            measure(effects, cells, asked.turns, asked.budget, live=kind == "live")
            for cells in asked.cells or SIZES
        ]
        for kind, effects in kinds.items()
    }
    if asked.json:
        print(json.dumps(found))
        return
    print(METHOD.format(turns=asked.turns, budget=asked.budget))
    print(
        "                  cells   us a step, compiled   on arrays    us a cell, compiled   on arrays   ratio"
    )
    for kind, rows in found.items():
        for row in rows:
            cells = row["cells"]
            print(
                f"{kind:<12} {cells:>10,} {row['compiled_us']:>21.1f} {row['arrays_us']:>11.1f} "
                f"{row['compiled_us'] / cells:>22.3f} {row['arrays_us'] / cells:>11.3f} {row['ratio']:>7.2f}"
            )


if __name__ == "__main__":
    main()
