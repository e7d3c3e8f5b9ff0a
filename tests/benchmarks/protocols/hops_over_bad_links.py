"""What ``hop_gradient`` comes to over bad links and drifting clocks, and how soon it heals when cells die.

``python tests/benchmarks/protocols/hops_over_bad_links.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from bus.lattice import Lattice
from bus.partition import Partition
from bus.random_streams import rng
from cell_firmware.board import Board
from cell_firmware.controller import Controller
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.clock.mailbox import Mailbox
from cell_firmware.effects.clock.wrapper import LocalClockWrapper
from cell_firmware.effects.registry import CellEffects
from cell_firmware.firmware import Cells
from cell_firmware.loader import load
from cell_firmware.shard import Shard
from cell_firmware.specs import CellsSpec
from cell_firmware.toolkit.graph import hop_distance

SIDE, LIMIT, BEFORE, AFTER = 12, 145, 100, 400
LINKS: dict[str, dict[str, Any]] = {
    "as they are": {},
    "loss 0.05": {"link_loss": {"probability": 0.05}},
    "loss 0.2": {"link_loss": {"probability": 0.2}},
    "delay 4": {"link_delay": {"ticks": 4}},
    "delay 0 to 4, not in order": {"link_delay": {"between_ticks": [0, 4], "ordered": False}},
    "clocks off by up to 5 %": {"clock": {"error_ppm": 50_000}},
}
METHOD = f"""\
Method. hop_gradient on {SIDE} x {SIDE} cells, the goal in a corner, limit {LIMIT}, {{seeds}} seeds. In tick {BEFORE} a
tenth of the cells die, drawn by the seed (not the goal). "healed": how many ticks later all living cells have the
shortest distance among the living for the first time, median and greatest, of the seeds that came to it in {AFTER}
ticks ("of"). "too large", "too small": share of living cells and ticks with another distance, in the last {AFTER // 2}.
Breadth-first search says what is right; where the dead cut cells off, the limit is.
"""


def shard_of(lattice: Lattice, tables: dict[str, Any], ttl_periods: int, seed: int) -> Shard:
    """All cells as one shard, with the effects of the tables."""
    parameters = {"goals": [{"cell": [0, 0]}], "limit": LIMIT, "ttl_periods": ttl_periods}
    spec = CellsSpec(firmware="hop_gradient", parameters=parameters)
    cells = Cells.of(lattice, np.zeros((len(lattice), 2)), spec.period_s)
    effects, firmware, partition = CellEffects.model_validate(tables), load(spec), Partition.even(lattice, 1)
    controller: Controller = Board(firmware)
    if effects.clock is not None:
        clocks = effects.clock.clocks(lattice, spec.period_ns, seed)
        assert firmware.message is not None
        mailbox = Mailbox(firmware.message, clocks.clocks.window_ns)
        controller = LocalClockWrapper(Board(firmware, None, mailbox), clocks)
    site = ShardContext(partition.cells(0), 1, controller.link_type, seed)
    return Shard(controller, cells, partition, 0, effects.input_filters(site))


def course(
    tables: dict[str, Any], ttl_periods: int, seed: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Living cells' distances in every tick after the deaths, ``(ticks, living)``, and what is right."""
    lattice = Lattice((row, column) for row in range(SIDE) for column in range(SIDE))
    draw = rng(seed, "benchmark.dead")
    dead = {
        lattice.cells[1 + i]
        for i in draw.choice(len(lattice) - 1, len(lattice) // 10, replace=False).tolist()
    }
    living = Lattice(set(lattice.cells) - dead)
    right = hop_distance(living, np.array([living.index((0, 0))]))
    shard = shard_of(lattice, tables, ttl_periods, seed)
    nothing = np.zeros((len(lattice), 1), dtype=np.bool_)
    found: list[NDArray[np.int64]] = []
    for tick in range(BEFORE + AFTER):
        if tick == BEFORE:
            shard.retire(dead)
        shard.step(tick, nothing)
        if tick >= BEFORE:
            found.append(shard.registers()[1]["firmware.distance"].astype(np.int64))
    return np.array(found), np.where(right < 0, LIMIT, right)


def measured(tables: dict[str, Any], ttl_periods: int, seeds: int) -> str:
    """A row of the table."""
    healed: list[int] = []
    large = small = seen = 0
    for seed in range(seeds):
        distance, right = course(tables, ttl_periods, seed)
        exact = (distance == right).all(axis=1)
        healed += [int(np.argmax(exact))] if exact.any() else []
        late = distance[AFTER // 2 :]
        large, small, seen = large + (late > right).sum(), small + (late < right).sum(), seen + late.size
    span = f"{np.median(healed):8.0f}{max(healed):6}" if healed else f"{'-':>8}{'-':>6}"
    return f"{span}{len(healed):5}{large / seen:12.1e}{small / seen:12.1e}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=50)
    seeds = parser.parse_args().seeds
    print(METHOD.format(seeds=seeds))
    print(f"{'links':28}{'ttl_periods':>9}{'healed':>8}{'max':>6}{'of':>5}{'too large':>12}{'too small':>12}")
    for name, tables in LINKS.items():
        for ttl_periods in (1, 4, 8):
            print(f"{name:28}{ttl_periods:9}{measured(tables, ttl_periods, seeds)}", flush=True)


if __name__ == "__main__":
    main()
