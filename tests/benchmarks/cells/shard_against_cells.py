"""A bundled protocol on a shard's arrays beside the same protocol cell by cell: ticks a second, in one run.

``python tests/benchmarks/cells/shard_against_cells.py`` prints its method and its figures.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from bus.lattice import SIDES, Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs, PerCellAdapter
from cell_firmware.firmware import Cells, Firmware
from cell_firmware.protocols.heat_diffusion import HeatDiffusion, HeatDiffusionParameters
from cell_firmware.shard import BoundaryMessages, Shard

METHOD = """\
Method. heat_diffusion on {side} x {side} cells, one corner hot; no bus, no plant, one process, processor time, in
turns, the best of {turns}. "arrays": one shard of all cells. "cell by cell": the same firmware as one shard a cell, its
messages carried over by a loop. "plain Python": the same update written as CellFirmware, all cells in one shard. All
three must come to the same speeds, bit by bit.
"""


class PlainHeat(CellFirmware):
    """``heat_diffusion`` for one cell, as one would write it first."""

    Parameters = HeatDiffusionParameters
    message = HeatDiffusion.message

    def init(self, cell: Cell) -> tuple[float, float]:
        row, column = np.array([cell.row]), np.array([cell.column])
        speed, _ = self.parameters.start(row, column)
        return float(speed[0, 0]), float(speed[0, 1])

    def step(self, state: tuple[float, float], inputs: CellInputs) -> tuple[tuple[float, float], CellOutputs]:
        x, y = state
        gain_x = gain_y = 0.0
        for side in SIDES:
            word = inputs.inbox[side]
            if word is not None:
                gain_x += word["vx_m_s"] - x
                gain_y += word["vy_m_s"] - y
        r = self.parameters.diffusion_number
        speed = (x + r * gain_x, y + r * gain_y)
        word = {"vx_m_s": speed[0], "vy_m_s": speed[1]}
        return speed, CellOutputs(speed, dict.fromkeys(SIDES, word))


def whole(firmware: Firmware, lattice: Lattice, cells: Cells) -> Callable[[], np.ndarray]:
    """One shard of all cells: a function that steps it."""
    shard = Shard(Board(firmware), cells, Partition.even(lattice, 1), 0)
    nothing, ticks = np.zeros((len(lattice), 1), dtype=np.bool_), iter(range(1 << 30))
    return lambda: shard.step(next(ticks), nothing).drive


def apart(firmware: Firmware, lattice: Lattice, cells: Cells) -> Callable[[], np.ndarray]:
    """One shard a cell, of a lattice of its own with the neighbours on it, for a partition of all would be large."""
    n = len(lattice)
    shards: list[Shard] = []
    hears: list[
        list[tuple[int, int]]
    ] = []  # of every incoming link: who sends, and on which of its outgoing ones
    order: list[list[int]] = []
    for i in range(n):
        near = [j for j in lattice.neighbours[i].tolist() if j >= 0]
        own = Lattice(lattice.cells[j] for j in (i, *near))
        here = own.index(lattice.cells[i])
        partition = Partition(own, [[here], *([j] for j in range(len(own)) if j != here)])
        rows = np.array([lattice.index(cell) for cell in own.cells])
        shards.append(Shard(Board(firmware), cells.select(rows), partition, 0))
        out = partition.outgoing(0)
        order.append(out.source_side.tolist())
        into = partition.incoming(0)
        hears.append(
            [
                (lattice.index(own.cells[source]), side)
                for source, side in zip(into.source.tolist(), into.source_side.tolist(), strict=True)
            ]
        )
    links: list[BoundaryMessages | None] = [None] * n
    nothing, ticks = np.zeros((1, 1), dtype=np.bool_), iter(range(1 << 30))
    slot = [{side: at for at, side in enumerate(sides)} for sides in order]

    def step() -> np.ndarray:
        tick = next(ticks)
        done = [shard.step(tick, nothing, None, link) for shard, link in zip(shards, links, strict=True)]
        for i, heard in enumerate(hears):
            sent = np.empty(len(heard), dtype=np.bool_)
            message = np.empty(len(heard), dtype=firmware.message)
            for at, (source, side) in enumerate(heard):
                theirs = done[source].links
                assert theirs is not None
                sent[at], message[at] = theirs.sent[slot[source][side]], theirs.message[slot[source][side]]
            links[i] = BoundaryMessages(sent, message)
        return np.concatenate([one.drive for one in done])

    return step


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--side", type=int, default=100)
    parser.add_argument("--turns", type=int, default=3)
    asked = parser.parse_args()
    print(METHOD.format(side=asked.side, turns=asked.turns))
    lattice = Lattice((r, c) for r in range(asked.side) for c in range(asked.side))
    position = 0.1 * np.stack((lattice.columns, lattice.rows), axis=1)
    cells = Cells.of(lattice, position, 0.004096)
    hot = HeatDiffusionParameters.model_validate({"initial": [{"cell": [0, 0], "speed_m_s": [1.0, -0.5]}]})
    ways = {
        "arrays": (whole(HeatDiffusion(hot), lattice, cells), 20),
        "cell by cell": (apart(HeatDiffusion(hot), lattice, cells), 1),
        "plain Python": (whole(PerCellAdapter(PlainHeat(hot)), lattice, cells), 1),
    }
    least = dict.fromkeys(ways, float("inf"))
    drives: dict[str, list[np.ndarray]] = {name: [] for name in ways}
    for _ in range(asked.turns):
        for name, (step, ticks) in ways.items():
            start = time.process_time()
            drives[name] += [step() for _ in range(ticks)]
            least[name] = min(least[name], (time.process_time() - start) / ticks)
    for name, seconds in least.items():
        print(f"{name:14}{1.0 / seconds:10.2f} ticks/s{seconds / least['arrays']:10.1f} times as long")
        same = all((a == b).all() for a, b in zip(drives["arrays"], drives[name], strict=False))
        assert same, f"{name} comes to other speeds"
    ratio = min(least["cell by cell"], least["plain Python"]) / least["arrays"]
    print(f"arrays are {ratio:.0f} times as fast as the faster of the others; must be at least 20")
    sys.exit(ratio < 20)


if __name__ == "__main__":
    main()
