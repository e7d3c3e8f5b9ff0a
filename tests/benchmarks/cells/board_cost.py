"""What a board costs: one control period of a shard with each of its effects, beside the behavioural level.

``python tests/benchmarks/cells/board_cost.py`` prints its method and its figures.
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
from plant.effects.motors import Motors as PlantMotors
from plant.effects.motors import MotorsSpec

SIZES = {18: (3, 6), 1_000: (25, 40), 10_000: (100, 100)}
BUDGET_S = 0.4
"""Of processor time, that each side has in a turn."""
DEARER: dict[str, dict[str, Any]] = {
    "clock, 1 %": {"clock": {"error_ppm": 10_000.0}},
    "polled": {"serial": {"ring_bytes": 0}},
    "mux": {"serial": {"sharing": "mux", "dwell_periods": 8}},
}
"""Settings that are not the board's: clocks far apart, and lines that have to be followed byte by byte."""
MOTORS = MotorsSpec()
METHOD = """\
Method. heat_diffusion (two speeds to each neighbour every period) on wheels with motors, one shard, steps of
Shard.step in this process, processor time. Behavioural: the speed loop in floating point, whole messages.
Beside it, taking turns: each effect of the board hc11 alone, and all together. Wheels follow their voltages
exactly in between, which is not timed. Ratio: a step's time over the behavioural step's, median of {turns}
turns; least and greatest ratio of a turn in brackets. All together must cost 4 times at most. Below the line,
each alone: settings that the board does not have, clocks off by up to 1 %, and serial lines byte by byte.
"""


class Side:
    """A shard with some effects, on motors."""

    def __init__(self, effects: dict[str, Any], lattice: Lattice) -> None:
        field = CellEffects.model_validate(effects)
        spec = CellsSpec(firmware="heat_diffusion")
        firmware, partition = load(spec), Partition.even(lattice, 1)
        clocks = None if field.clock is None else field.clock.clocks(lattice, spec.period_ns, 1)
        motors = MotorFacts(MOTORS.supply_v, MOTORS.supply_v * MOTORS.first_order.speed_per_volt_m_s)
        controller = build_controller(firmware, spec, field, motors, clocks)
        site = ShardContext(partition.cells(0), 1, controller.link_type, 1)
        cells = Cells.of(lattice, np.zeros((len(lattice), 2)), spec.period_s)
        self.shard = Shard(controller, cells, partition, 0, field.input_filters(site))
        self.wheels = PlantMotors(MOTORS, len(lattice))
        self.period_s = spec.period_s
        self.there = np.zeros((len(lattice), 1), dtype=np.bool_)
        self.tick = 0

    def step_s(self, budget_s: float) -> float:
        """Processor time of a step, the mean of as many as the budget has."""
        spent, steps = 0.0, 0
        while spent < budget_s:
            self.there[self.tick % len(self.there)] ^= True
            encoder = self.wheels.travel
            began = time.process_time()
            drive = self.shard.step(self.tick, self.there.copy(), encoder).drive
            spent += time.process_time() - began
            self.wheels.elapse(self.wheels.command(drive, self.period_s), self.period_s)
            self.tick += 1
            steps += 1
        return spent / steps


def measure(size: int, turns: int, budget_s: float) -> dict[str, Any]:
    """Time of a behavioural step, and of each effect the ratios, turn by turn."""
    rows, columns = SIZES[size]
    lattice = Lattice((row, column) for row in range(rows) for column in range(columns))
    board = {name: dict(table) for name, table in BOARDS["hc11"].items()}
    asked = {
        "behavioural": {},
        **{name: {name: table} for name, table in board.items()},
        "all": board,
        **DEARER,
    }
    sides = {name: Side(effects, lattice) for name, effects in asked.items()}
    for side in sides.values():
        side.step_s(0.1 * budget_s)
    times: dict[str, list[float]] = {name: [] for name in sides}
    for _ in range(turns):
        for name, side in sides.items():
            times[name].append(side.step_s(budget_s))
    base = times.pop("behavioural")
    ratios = {name: [one / by for one, by in zip(found, base, strict=True)] for name, found in times.items()}
    return {"cells": size, "behavioural_us_a_cell": 1e6 * median(base) / size, "ratios": ratios}


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--turns", type=int, default=5)
    parser.add_argument("--json", action="store_true", help="one JSON object")
    parser.add_argument("--cells", type=int, choices=list(SIZES), action="append", help="only so many")
    parser.add_argument("--budget", type=float, default=BUDGET_S, help="of processor time a side and turn, s")
    asked = parser.parse_args()
    sizes: list[int] = asked.cells or list(SIZES)
    found = [measure(size, asked.turns, asked.budget) for size in sizes]
    if asked.json:
        print(json.dumps(found))
        return
    print(METHOD.format(turns=asked.turns))
    print("  ".join(["effect       ", *(f"{size:>18,} cells" for size in sizes)]))
    print(
        "  ".join(["behavioural  ", *(f"{one['behavioural_us_a_cell']:>16.2f} us a cell" for one in found)])
    )
    for name in found[0]["ratios"]:
        if name == next(iter(DEARER)):
            print("-" * 13)
        cells = (
            f"{median(one['ratios'][name]):.2f} ({min(one['ratios'][name]):.2f}-{max(one['ratios'][name]):.2f})"
            for one in found
        )
        print("  ".join([f"{name:<13}", *(f"{text:>24}" for text in cells)]))


if __name__ == "__main__":
    main()
