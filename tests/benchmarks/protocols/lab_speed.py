"""Pace of a lab of 100 cells, compiled and in plain Python, without and with faults; and states a second of a search.

Processor time of this process, the best of some turns.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable

import numpy as np

from deploy.studies.adversary.check import check_exhaustively, world_scene
from deploy.studies.adversary.spec import Adversary
from mdms import SIDES, Cell, CellFirmware, CellInputs, CellOutputs, Lab


class Plain(CellFirmware):
    """Diffusion in plain Python: reads four messages and sends four."""

    message = np.dtype([("value", "<f8")])

    def init(self, cell: Cell) -> float:
        return float(cell.row)

    def step(self, state: float, inputs: CellInputs) -> tuple[float, CellOutputs]:
        value = state
        for word in inputs.inbox.values():
            if word is not None:
                value += 0.2 * (word["value"] - state)
        word = {"value": value}
        return value, CellOutputs((value, 0.0), dict.fromkeys(SIDES, word))


class Mixed(Plain):
    """The same on whole numbers, with a condition: states stay few, and transitions many."""

    def step(self, state: float, inputs: CellInputs) -> tuple[float, CellOutputs]:
        heard = [word["value"] for word in inputs.inbox.values() if word is not None]
        value = (3 * state + sum(heard) + len(heard)) % 31
        word = {"value": value}
        return value, CellOutputs((0.0, 0.0), dict.fromkeys(SIDES, word))

    def invariants(self, view):  # type: ignore[no-untyped-def]
        yield "values are below 31", view["state"] < 31


def pace(lab: Lab, ticks: int, turns: int) -> float:
    """Ticks per second of processor time, the best turn."""
    lab.step(20)
    return ticks / min(seconds(lambda: lab.step(ticks)) for _ in range(turns))


def seconds(work: Callable[[], object]) -> float:
    begun = time.process_time()
    work()
    return time.process_time() - begun


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--side", type=int, default=10)
    parser.add_argument("--ticks", type=int, default=1000)
    parser.add_argument("--turns", type=int, default=3)
    parser.add_argument("--depth", type=int, default=10)
    options = parser.parse_args()
    size, fault = (options.side, options.side), {"kind": "link_loss", "probability": 0.1, "share": 1.0}
    for name, firmware in (("compiled (heat_diffusion)", "heat_diffusion"), ("plain Python", Plain)):
        quiet = pace(Lab(firmware, size), options.ticks, options.turns)
        lossy = pace(Lab(firmware, size, faults=[fault]), options.ticks, options.turns)
        print(f"{name:<26} {quiet:>9,.0f} ticks/s, with losses {lossy:>9,.0f}")
    scene = world_scene(Mixed, (2, 3))
    adversary = Adversary(2, options.depth, ("loss", "delay", "death"))
    begun = time.process_time()
    result, _ = check_exhaustively(scene, adversary, most_states=100_000)
    spent = time.process_time() - begun
    print(
        f"search of 2 x 3 cells: {result.states:,} states, {result.transitions:,} transitions, "
        f"{result.states / spent:,.0f} states/s"
    )


if __name__ == "__main__":
    main()
