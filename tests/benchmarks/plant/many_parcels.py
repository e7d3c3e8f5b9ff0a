"""What a parcel costs among a thousand on a million cells, beside what it costs alone.

``python tests/benchmarks/plant/many_parcels.py`` measures and prints its method.
"""

from __future__ import annotations

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[3]))

from plant.friction.viscous import Viscous
from plant.parcel_spec import ArraySpec, ParcelSpec
from plant.plant import Plant
from plant.solver_api import Segment
from plant.solver_specs import ExactSpec
from plant.solvers.compiled import AdvanceArgs, ThreadedSolver
from plant.specs import PlantSpec
from plant.wheels import WheelMotion

PITCH_M = 0.1
WELL_CELLS = 30
PERIOD_NS = 4_096_000
BEGIN_NS = 1_000_000_000
LONG_S = 4.0
SAMPLE = 20
"""Parcels that are moved alone, ..."""
TICKS = 50
"""... each by so many ticks in a row."""
TARGET = 1.5

METHOD = """\
Method. {parcels} parcels of 0.54 x 0.32 m at angles of their own, each in a well of {well} x {well} cells whose
elliptic field draws it to its middle, on {side} x {side} cells; exact solver, 1e-9; {threads} threads. Every turn
begins {begin:g} s into the run. "ticks": all are moved by a tick of {tick:g} ms, five times; alone, {sample} of them
are moved one after the other, by {ticks} ticks each. "long": all are moved by {long:g} s in one call; alone, each by
a call of its own. "solver" is Solver.advance; "plant" is Plant.advance with senses, events and status, where the
one that is alone has an array of its own and bears by itself that a million drives are copied. "kernel" is the
compiled function by itself in one thread: all parcels in a call, or one parcel's ticks in a call; what is left there
is that a thousand parcels don't stay in the processor's cache from tick to tick.
us is wall time times threads, by moves of a parcel; alone there is one thread. cpu is the same in processor time,
which a busy machine disturbs less. Medians of {turns} turns, both sides in each.
"""

Move = Callable[[], int]
"""Moves parcels; returns how many moves of one parcel that were."""


@dataclass(frozen=True)
class Row:
    """Costs of one parcel's move in one turn, or their medians.

    Attributes:
        case: What was moved, and through which interface.
        many_us: Wall time times threads, among all.
        alone_us: Wall time, alone.
        many_cpu_us: Processor time, among all.
        alone_cpu_us: Processor time, alone.
        target: Of the ratio, where there is one.
    """

    case: str
    many_us: float
    alone_us: float
    many_cpu_us: float
    alone_cpu_us: float
    target: float | None

    @property
    def ratio(self) -> float:
        return self.many_us / self.alone_us

    @property
    def cpu_ratio(self) -> float:
        return self.many_cpu_us / self.alone_cpu_us


def scene(parcels: int, side: int) -> PlantSpec:
    """The first so many parcels, on the whole array."""
    draw = np.random.default_rng(1)
    across = side // WELL_CELLS
    middle = (np.arange(across) - 0.5 * (across - 1)) * WELL_CELLS * PITCH_M
    return PlantSpec(
        array=ArraySpec(rows=side, columns=side, pitch_m=PITCH_M),
        parcels=tuple(
            ParcelSpec(
                size_m=(0.54, 0.32),
                mass_kg=2.0,
                position_m=(middle[i % across] + 0.55, middle[i // across] + 0.5),
                angle_rad=float(draw.uniform(-np.pi, np.pi)),
            )
            for i in range(parcels)
        ),
        friction=Viscous(coefficient_s_per_m=0.2),
        solver=ExactSpec(tolerance=1e-9),
    )


def wells(plant: Plant, side: int) -> NDArray[np.float64]:
    """Wheel speeds ``(n, 2)``, m/s: an elliptic field about the middle of every well."""
    across = side // WELL_CELLS
    width = WELL_CELLS * PITCH_M
    offset = plant.array.positions_m + 0.5 * across * width
    return (offset % width - 0.5 * width) * (-1.0, -2.0)


class Side:
    """A plant that can be taken back to where it was, its wheels at constant speeds."""

    def __init__(self, parcels: int, side: int) -> None:
        self.plant = Plant(scene(parcels, side))
        self.speeds = wells(self.plant, side)
        self.solver: ThreadedSolver = self.plant._solver
        still = np.zeros_like(self.speeds)
        self.motion = WheelMotion(self.speeds, still, 0.0)
        self.grip = np.ones(len(self.speeds))
        self.everyone = np.arange(parcels)
        self._none, self._out = np.zeros(0), np.zeros((0, parcels, 6))
        self.plant.advance(self.speeds, BEGIN_NS)
        packed = self.solver.packed
        self._held = [packed.y, packed.mem, packed.ctl, packed.par, self.solver._allowance]
        self._kept = [array.copy() for array in self._held]

    def back(self) -> None:
        """Take the parcels back to the beginning of a turn; the plant's clock goes on."""
        for array, kept in zip(self._held, self._kept, strict=True):
            array[:] = kept

    def solve(self, which: NDArray[np.int64], span_s: float, times: int) -> int:
        """Move parcels through the solver, so many times in a row."""
        leg = Segment.through(self.motion, self.grip, span_s, len(self.everyone))
        for _ in range(times):
            self.solver.advance(which, leg)
        return len(which) * times

    def tick(self, times: int) -> int:
        """Move all parcels through the plant."""
        for _ in range(times):
            self.plant.advance(self.speeds, self.plant.time_ns + PERIOD_NS)
        return len(self.everyone) * times

    def run_kernel(self, block: NDArray[np.int64]) -> int:
        """Move a block by a tick in one call of the kernel, and parcels that it names again by as many ticks."""
        solver, workspace = self.solver, self.solver.workspace(0)
        surface = solver._surface(self.motion, self.grip)
        args = AdvanceArgs(surface, PERIOD_NS * 1e-9, self._none, self._out)
        moved, _ = solver._advance_block(workspace, block, args)
        return moved


def cost_us(side: Side, move: Move) -> tuple[float, float]:
    """Wall and processor time, us, of one move."""
    side.back()
    wall, cpu = time.perf_counter(), time.process_time()
    moves = move()
    cpu, wall = time.process_time() - cpu, time.perf_counter() - wall
    return wall / moves * 1e6, cpu / moves * 1e6


def measure(turns: int, parcels: int, side: int) -> tuple[list[Row], int]:
    """Rows of medians, and how many threads there were."""
    many, single = Side(parcels, side), Side(1, side)
    threads = many.solver.thread_pool.threads
    sample = many.everyone[:: parcels // SAMPLE]
    tick_s = PERIOD_NS * 1e-9

    def each(which: NDArray[np.int64], span_s: float, times: int) -> int:
        return sum(many.solve(np.array([i]), span_s, times) for i in which.tolist())

    cases: list[tuple[str, float | None, int, Move, Side, Move]] = [
        ("kernel, ticks", None, 1, lambda: many.run_kernel(many.everyone), many,
         lambda: sum(many.run_kernel(np.full(TICKS, i)) for i in sample.tolist())),
        ("solver, ticks", TARGET, threads, lambda: many.solve(many.everyone, tick_s, 5), many,
         lambda: each(sample, tick_s, TICKS)),
        ("solver, long", TARGET, threads, lambda: many.solve(many.everyone, LONG_S, 1), many,
         lambda: each(many.everyone, LONG_S, 1)),
        ("plant, ticks", None, threads, lambda: many.tick(5), single, lambda: single.tick(TICKS)),
    ]  # fmt: skip
    rows: list[Row] = []
    for case, target, used, together, other, alone in cases:
        cost_us(many, together)
        cost_us(other, alone)
        spent = [cost_us(many, together) + cost_us(other, alone) for _ in range(turns)]
        wall, cpu, alone_wall, alone_cpu = (statistics.median(column) for column in zip(*spent, strict=True))
        rows.append(Row(case, wall * used, alone_wall, cpu, alone_cpu, target))
    return rows, threads


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--turns", type=int, default=9, help="turns of each")
    parser.add_argument("--json", action="store_true", help="print one JSON object")
    parser.add_argument("--parcels", type=int, default=1_000, help=f"{SAMPLE} at least")
    parser.add_argument(
        "--side", type=int, default=1_000, help=f"of the array: {WELL_CELLS} cells a parcel, both ways"
    )
    options = parser.parse_args()
    rows, threads = measure(options.turns, options.parcels, options.side)
    if options.json:
        figures = [asdict(row) | {"ratio": row.ratio, "cpu_ratio": row.cpu_ratio} for row in rows]
        print(json.dumps({"threads": threads, "rows": figures}))
        return
    told = {"threads": threads, "turns": options.turns, "begin": BEGIN_NS * 1e-9, "tick": PERIOD_NS * 1e-6}
    told |= {
        "parcels": options.parcels,
        "side": options.side,
        "well": WELL_CELLS,
        "sample": SAMPLE,
        "ticks": TICKS,
        "long": LONG_S,
    }
    print(METHOD.format(**told))
    print(
        f"{'a move':16}{'us':>10}{'alone':>10}{'ratio':>7}{'cpu us':>10}{'alone':>10}{'ratio':>7}{'target':>8}"
    )
    for row in rows:
        limit = "" if row.target is None else f"<= {row.target}"
        print(
            f"{row.case:16}{row.many_us:10.2f}{row.alone_us:10.2f}{row.ratio:7.2f}"
            f"{row.many_cpu_us:10.2f}{row.alone_cpu_us:10.2f}{row.cpu_ratio:7.2f}{limit:>8}"
        )


if __name__ == "__main__":
    main()
