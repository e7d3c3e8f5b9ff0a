"""Cells in the plant's thread: what they give the plant stays as it was."""

from __future__ import annotations

import numpy as np

import mdms
from cell_firmware.firmware import Cells, Firmware, Inputs, Outputs, State
from cell_firmware.program import NoParameters


class OneArray(Firmware):
    """Drives by one and the same array in all ticks, in the k-th by k cm/s."""

    Parameters = NoParameters
    message = None

    def init(self, cells: Cells) -> State:
        self.speed_m_s = np.zeros((len(cells), 2))
        return {"tick": np.zeros(len(cells), dtype=np.int64)}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        del inputs
        self.speed_m_s[:] = 0.01 * state["tick"][:, None]
        return {"tick": state["tick"] + 1}, Outputs(self.speed_m_s)


def test_wheels_do_not_run_by_an_array_that_a_program_fills_anew() -> None:
    table = mdms.load_scene("elliptic").model_dump()
    scene = mdms.load_scene({**table, "cells": {"firmware": OneArray}})
    with mdms.Simulation.open(scene) as simulation:
        records = [simulation.step() for _ in range(4)]
    for tick, record in enumerate(records):
        assert record is not None
        assert set(np.unique(record.drives)) == {0.01 * tick}
        assert set(np.unique(record.wheel_speed)) == {0.01 * max(tick - 1, 0)}
