"""``route`` where messages get lost or late, clocks drift and cells die: do all parcels come to their exits, unhurt?

``python tests/benchmarks/protocols/sorting_over_bad_links.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from bus.random_streams import rng
from cell_firmware.effects.registry import CellEffects
from cell_firmware.protocols.route import Route
from tests.cell_firmware.protocols.tile_world import World

LANES = ["e e se .", "e ne e ."]
EXITS = [{"tile": [0, 3], "side": "east"}, {"tile": [1, 3], "side": "east"}]
PARCELS, MOST_TICKS = 6, 3000
CASES: dict[str, dict[str, Any]] = {
    "links as they are": {},
    "loss 0.05": {"link_loss": {"probability": 0.05}},
    "loss 0.2": {"link_loss": {"probability": 0.2}},
    "delay 2": {"link_delay": {"ticks": 2}},
    "delay 0 to 4, not in order": {"link_delay": {"between_ticks": [0, 4], "ordered": False}},
    "clocks off by up to 1 %": {"clock": {"error_ppm": 10_000}},
    "5 % die": {},
    "10 % die": {},
}
DYING = {"5 % die": 0.05, "10 % die": 0.1}
METHOD = f"""\
Method. Two rows of four tiles of 4 x 4 cells, two entries, two exits, each reached from both entries; {PARCELS}
parcels a seed, exits drawn; no physics (parcels move as the wheels under them do on the average); control period 16 ms,
{{seeds}} seeds. "all": seeds in which every parcel left; "stranded": parcels that were still there or waiting
{MOST_TICKS} ticks on, of all; "misrouted": parcels that left elsewhere; "met": ticks and pairs that overlapped;
"ticks": until the last one left, median of the seeds in which all did. Cells die at instants drawn from the first 300
ticks.
"""


@dataclass
class Course:
    """What became of the parcels of one seed."""

    stranded: int
    misrouted: int
    met: int
    ticks: int


def course(name: str, seed: int) -> Course:
    """One seed of a case."""
    draw = rng(seed, "benchmark.sorting")
    exits = draw.integers(1, 3, PARCELS).tolist()
    queues = {(row, 0): exits[row::2] for row in range(2)}
    firmware = Route(Route.Parameters.model_validate({"lanes": LANES, "exits": EXITS}))
    world = World(firmware, queues, CellEffects.model_validate(CASES[name]), seed)
    n = len(world.lattice)
    doomed = draw.choice(n, round(DYING.get(name, 0.0) * n), replace=False)
    for tick, cell in sorted(zip(draw.integers(0, 300, len(doomed)).tolist(), doomed.tolist(), strict=True)):
        world.run(tick - world.tick)
        world.kill([world.lattice.cells[cell]])
    world.run(MOST_TICKS - world.tick)
    return Course(
        PARCELS - len(world.left),
        sum(exit_ != own for exit_, own in world.left),
        world.met,
        world.tick,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=50)
    seeds = parser.parse_args().seeds
    print(METHOD.format(seeds=seeds))
    print(f"{'':28}{'all':>6}{'stranded':>10}{'misrouted':>11}{'met':>6}{'ticks':>8}")
    for name in CASES:
        courses = [course(name, seed) for seed in range(seeds)]
        ticks = [one.ticks for one in courses if not one.stranded]
        sums = [sum(getattr(one, field) for one in courses) for field in ("stranded", "misrouted", "met")]
        counts = f"{len(ticks):6}{sums[0]:10}{sums[1]:11}{sums[2]:6}"
        print(f"{name:28}{counts}{np.median(ticks) if ticks else float('nan'):8.0f}", flush=True)


if __name__ == "__main__":
    main()
