"""Cost of random numbers of programs: a tick of a shard with none, and with four that the program doesn't look at.

``python tests/benchmarks/cells/random_draws.py`` prints its method and its figures.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs, PerCellAdapter
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import NoParameters
from cell_firmware.scalar_program import ScalarProgram
from cell_firmware.shard import Shard

NAMES = ("a", "b", "c", "d")
METHOD = """\
Method. A program that sends a number to all sides, in three forms, with no random numbers and with four; one shard, no
bus, no plant; processor time of a tick, in turns, the best of 7; "a number" is the difference over cells and numbers.
"""


class Plain(CellFirmware):
    message = np.dtype([("n", "<i8")])

    def init(self, cell: Cell) -> int:
        return cell.row

    def step(self, state: int, inputs: CellInputs) -> tuple[int, CellOutputs]:
        return state + 1, CellOutputs((0.1, 0.0), {side: {"n": state} for side in inputs.inbox})


class Arrays(Firmware):
    message = np.dtype([("n", "<i8")])

    def init(self, cells: Cells) -> State:
        return {"n": cells.row.copy()}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        outbox = Outbox.to_all(self.message, n=state["n"])
        return {"n": state["n"] + 1}, Outputs(np.full((len(inputs.presence), 2), 0.1), outbox)


class Scalar(ScalarProgram):
    message = np.dtype([("n", "<i8")])
    state_type = np.dtype([("n", "<i8")])

    def init(self, cells: Cells) -> State:
        return {"n": cells.row.copy()}

    @staticmethod
    def cell_step(constants: Any, state: Any, inputs: Any, outputs: Any) -> None:
        for side in range(4):
            outputs.sent[side] = 1
            outputs.message[side].n = state.n
        state.n += 1
        outputs.speed_m_s[0] = 0.1


def shard_of(kind: Any, names: tuple[str, ...], side: int) -> Shard:
    program = type(kind.__name__, (kind,), {"random": names, "__module__": __name__})(NoParameters())
    firmware: Firmware = PerCellAdapter(program) if isinstance(program, CellFirmware) else program
    lattice = Lattice((r, c) for r in range(side) for c in range(side))
    position_m = np.stack((0.1 * lattice.columns, 0.1 * lattice.rows), axis=1)
    return Shard(
        Board(firmware, seed=1), Cells.of(lattice, position_m, 0.004096), Partition.even(lattice, 1), 0
    )


def main() -> None:
    """Print the method and the figures."""
    print(METHOD)
    print(f"{'form':>8} {'cells':>6} {'none, us':>10} {'four, us':>10} {'a number, ns':>13}")
    for kind in (Plain, Arrays, Scalar):
        for side, ticks in ((1, 2_000), (100, 8 if kind is Plain else 60)):
            shards = [shard_of(kind, names, side) for names in ((), NAMES)]
            best, tick = [np.inf, np.inf], 0
            bits = np.zeros((side * side, 1), dtype=np.bool_)
            for _ in range(7):
                for i, shard in enumerate(shards):
                    begun = time.process_time()
                    for k in range(tick, tick + ticks):
                        shard.step(k, bits)
                    best[i] = min(best[i], (time.process_time() - begun) / ticks)
                tick += ticks
            number = (best[1] - best[0]) / (len(NAMES) * side * side)
            figures = f"{1e6 * best[0]:>10.1f} {1e6 * best[1]:>10.1f} {1e9 * number:>13.1f}"
            print(f"{kind.__name__:>8} {side * side:>6} {figures}")


if __name__ == "__main__":
    main()
