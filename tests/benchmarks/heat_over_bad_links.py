"""What ``heat_diffusion`` comes to where messages get lost or take their time: bias, scatter, pace.

``python tests/benchmarks/heat_over_bad_links.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.effects.registry import CellEffects
from cell_firmware.effects.stage import Site
from cell_firmware.firmware import Cells
from cell_firmware.loader import load
from cell_firmware.shard import Shard
from cell_firmware.specs import CellsSpec

ROWS, COLUMNS, TICKS, LAST = 6, 12, 2500, 500
NUMBER, SPEED_M_S = 0.2, 0.3
LINKS: dict[str, dict[str, Any]] = {
    "as they are": {},
    "loss 0.1": {"link_loss": {"probability": 0.1}},
    "loss 0.5": {"link_loss": {"probability": 0.5}},
    "delay 4": {"link_delay": {"ticks": 4}},
    "delay 0 to 4": {"link_delay": {"between_ticks": [0, 4]}},
    "delay 0 to 4, not in order": {"link_delay": {"between_ticks": [0, 4], "ordered": False}},
}
METHOD = f"""\
Method. heat_diffusion (diffusion number {NUMBER}) on {ROWS} x {COLUMNS} cells, {TICKS} ticks, {{seeds}} seeds.
Held: the left edge at {SPEED_M_S} m/s, the right edge at 0; all else starts at 0. The steady state is a straight
line. "bias": the greatest distance of a cell's mean, over seeds and the last {LAST} ticks, from that line, by
{SPEED_M_S} m/s; "error": what the seeds' scatter alone makes of a cell's mean, one standard deviation, the greatest;
"scatter": the root mean square deviation of a cell in a tick; "settled": the first tick from which every
column's mean, over rows and seeds, is within 2 % of the line.
Free: none held, one corner cell starts at 1 m/s, the others at 0. "level": the sum of all speeds at the end over that
at the start, which links as they are keep: mean and standard deviation over the seeds.
"""


def speeds(effects: CellEffects, seed: int, parameters: dict[str, Any]) -> NDArray[np.float64]:
    """Speed along x of every cell in every tick, ``(ticks, rows, columns)`` m/s."""
    lattice = Lattice((row, column) for row in range(ROWS) for column in range(COLUMNS))
    spec = CellsSpec(firmware="heat_diffusion", parameters={"diffusion_number": NUMBER, **parameters})
    cells = Cells.of(lattice, np.zeros((len(lattice), 2)), spec.period_s)
    firmware, partition = load(spec), Partition.even(lattice, 1)
    site = Site(partition.cells(0), 1, firmware.message, seed)
    shard = Shard(Board(firmware), cells, partition, 0, effects.stages(site))
    nothing = np.zeros((len(lattice), 1), dtype=np.bool_)
    found = [shard.step(tick, nothing).drive[:, 0] for tick in range(TICKS)]
    return np.array(found).reshape(TICKS, ROWS, COLUMNS)


def between_held(effects: CellEffects, seeds: int) -> tuple[float, float, float, int]:
    """Bias, its error, scatter and the tick from which the mean has settled."""
    edges = ((0, SPEED_M_S), (COLUMNS - 1, 0.0))
    held = [{"cell": [row, column], "speed_m_s": [v, 0.0]} for column, v in edges for row in range(ROWS)]
    line = np.linspace(1.0, 0.0, COLUMNS)
    off = np.array([speeds(effects, seed, {"held": held}) / SPEED_M_S - line for seed in range(seeds)])
    unsettled = np.flatnonzero(abs(off.mean(axis=(0, 2))).max(axis=1) > 0.02)
    means = off[:, -LAST:].mean(axis=1)
    bias, error = abs(means.mean(axis=0)).max(), means.std(axis=0).max() / np.sqrt(seeds)
    return float(bias), float(error), float(np.sqrt((off[:, -LAST:] ** 2).mean())), int(unsettled[-1]) + 1


def left_free(effects: CellEffects, seeds: int) -> tuple[float, float]:
    """Mean and standard deviation of the level that is left at the end."""
    hot = {"initial": [{"cell": [0, 0], "speed_m_s": [1.0, 0.0]}]}
    levels = [float(speeds(effects, seed, hot)[-1].sum()) for seed in range(seeds)]
    return float(np.mean(levels)), float(np.std(levels))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=50)
    seeds = parser.parse_args().seeds
    print(METHOD.format(seeds=seeds))
    print(f"{'links':28}{'bias':>9}{'error':>9}{'scatter':>10}{'settled':>9}{'level':>9}{'+-':>8}")
    for name, tables in LINKS.items():
        effects = CellEffects.model_validate(tables)
        chance = seeds if "link_loss" in tables or "between_ticks" in tables.get("link_delay", {}) else 1
        bias, error, scatter, settled = between_held(effects, chance)
        level, spread = left_free(effects, chance)
        print(
            f"{name:28}{bias:9.1e}{error:9.1e}{scatter:10.1e}{settled:9}{level:9.3f}{spread:8.3f}", flush=True
        )


if __name__ == "__main__":
    main()
