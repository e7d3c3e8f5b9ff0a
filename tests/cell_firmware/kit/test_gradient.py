"""The gradient composed in plain Python: the registers of ``hop_gradient``, which has the same rule on arrays."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from mdms import SIDES, Cell, CellFirmware, CellInputs, CellOutputs, Lab
from mdms.kit import aged, descend

LIMIT, TTL_PERIODS = 12, 3


class Slope(NamedTuple):
    goal: bool
    distance: int
    counts: tuple[int, ...] = (0, 0, 0, 0)
    hops: tuple[int, ...] = (LIMIT, LIMIT, LIMIT, LIMIT)


class Gradient(CellFirmware):
    message = np.dtype([("distance", "u1")])

    def init(self, cell: Cell) -> Slope:
        goal = (cell.row, cell.column) == (1, 0)
        return Slope(goal, 0 if goal else LIMIT)

    def step(self, state: Slope, inputs: CellInputs) -> tuple[Slope, CellOutputs]:
        words = [inputs.inbox[side] for side in SIDES]
        counts = tuple(
            aged(word is not None, count, TTL_PERIODS)
            for word, count in zip(words, state.counts, strict=True)
        )
        hops = tuple(
            old if word is None else word["distance"] for word, old in zip(words, state.hops, strict=True)
        )
        distance, _ = descend(state.goal, counts, hops, LIMIT)
        word: Any = {"distance": distance}
        return Slope(state.goal, distance, counts, hops), CellOutputs((0.0, 0.0), dict.fromkeys(SIDES, word))


def test_a_plain_composition_has_the_registers_of_hop_gradient_through_losses_and_deaths() -> None:
    faults = [
        {"kind": "link_loss", "at_tick": 5, "until_tick": 30, "probability": 0.4, "share": 1.0},
        {"kind": "crash", "at_tick": 12, "until_tick": 45, "cells": [[1, 1], [0, 1], [2, 3]]},
    ]
    parameters = {"goals": [{"cell": [1, 0]}], "limit": LIMIT, "ttl_periods": TTL_PERIODS}
    arrays = Lab("hop_gradient", (3, 5), parameters=parameters, faults=faults, seed=4, check=None)
    plain = Lab(Gradient, (3, 5), faults=faults, seed=4)
    changes = 0
    for tick in range(60):
        expected, found = (lab.step().registers["distance"] for lab in (arrays, plain))
        running = [plain.lattice.index(cell) for cell in plain.alive]
        assert found[running].tolist() == expected[running].tolist(), tick
        changes += len(set(found.tolist()))
    assert changes > 200
