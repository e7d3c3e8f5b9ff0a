"""Steps of some cells: taken apart and put together, or taken by all and undone for the others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware import controller
from cell_firmware.board import Board
from cell_firmware.board_presets import BOARDS
from cell_firmware.clocks import ArrayClocks
from cell_firmware.controller import ControllerState, StepTime, read_only
from cell_firmware.effects.registry import CellEffects
from cell_firmware.errors import FirmwareFailed
from cell_firmware.firmware import Cells, Firmware, Inputs, Outputs, State
from cell_firmware.program import NoParameters
from cell_firmware.shard import Shard
from cell_firmware.specs import CellsSpec

LATTICE = Lattice((row, column) for row in range(3) for column in range(5))
N = len(LATTICE)
CELLS = Cells.of(LATTICE, np.zeros((N, 2)), 0.004096)


def state(**arrays: NDArray[Any]) -> ControllerState:
    return ControllerState(CELLS, {"part": read_only(arrays)})


def test_rolled_back_rows_are_as_before_whichever_arrays_a_step_returns() -> None:
    a, b = np.arange(N), np.arange(N) * 1.5
    wide = np.zeros((N, 2), dtype=[("x", "<f4"), ("y", "u1")])
    wide["x"], wide["y"] = a[:, None], 7
    before = state(
        a=a,
        b=b,
        swapped=a * 10,
        with_it=a * 100,
        view=a * 2,
        twice=a * 3,
        again=a * 4,
        typed=a * 5,
        wide=wide,
    )
    old = before.parts["part"]
    new, both = a * -1, a * -2
    moved = wide.copy()
    moved["x"] = -1.0
    after = state(
        a=new, b=b, swapped=old["with_it"], with_it=old["swapped"], view=old["view"][::-1], twice=both, again=both,
        typed=a * 0.5, wide=moved,
    )  # fmt: skip
    copies = {name: array.copy() for name, array in after.parts["part"].items()}
    rows = np.array([0, 3, 14])
    others = np.setdiff1d(np.arange(N), rows)
    rolled_back = after.rollback_rows(rows, before).parts["part"]
    untouched = {name: array.copy() for name, array in old.items()}
    for name, array in rolled_back.items():
        np.testing.assert_array_equal(array[rows], old[name][rows], err_msg=name)
        np.testing.assert_array_equal(array[others], copies[name][others], err_msg=name)
        assert not array.flags.writeable
    assert rolled_back["b"] is b
    assert rolled_back["a"] is new  # written to, not copied
    for name, array in old.items():
        np.testing.assert_array_equal(array, untouched[name])
    np.testing.assert_array_equal(old["swapped"], a * 10)
    np.testing.assert_array_equal(old["view"], a * 2)


def drives(effects: dict[str, Any], ticks: int) -> tuple[bytes, dict[str, NDArray[Any]]]:
    from cell_firmware.build import MotorFacts, build_controller
    from cell_firmware.effects.base import ShardContext
    from cell_firmware.loader import load

    enabled = CellEffects.model_validate(effects)
    spec = CellsSpec(
        firmware="heat_diffusion", parameters={"held": [{"cell": [0, 0], "speed_m_s": [0.2, 0.1]}]}
    )
    firmware = load(spec)
    assert enabled.clock is not None
    clocks: ArrayClocks = enabled.clock.clocks(LATTICE, spec.period_ns, 3)
    made = build_controller(firmware, spec, enabled, MotorFacts(12.0, 1.2), clocks)
    partition = Partition.even(LATTICE, 1)
    site = ShardContext(partition.cells(0), 1, made.link_type, 3)
    shard = Shard(made, CELLS, partition, 0, enabled.input_filters(site))
    found = bytearray()
    for tick in range(ticks):
        travel = np.outer(np.arange(N) * 1e-4 * tick, [1.0, -1.0])
        found += shard.step(tick, np.zeros((N, 1), dtype=np.bool_), travel).drive.tobytes()
    return bytes(found), shard.registers()[1]


@pytest.mark.parametrize(
    "effects", [{"clock": {"error_ppm": 30_000.0}}, {**BOARDS["hc11"], "clock": {"error_ppm": 2e4}}]
)
def test_stepping_all_and_undoing_some_is_stepping_the_others(
    effects: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[tuple[bytes, dict[str, NDArray[Any]]]] = []
    for most in (-1.0, 2.0):
        monkeypatch.setattr(controller, "_MOST", most)
        taken.append(drives(effects, 150))
    assert taken[0][0] == taken[1][0]
    assert {name: value.tobytes() for name, value in taken[0][1].items()} == {
        name: value.tobytes() for name, value in taken[1][1].items()
    }
    counts = taken[0][1]["clock.count"]
    assert counts.min() < counts.max()  # some were left out in some windows


class Raising(Firmware):
    """Counts its steps; fails on request."""

    def __init__(self, bad: set[int]) -> None:
        super().__init__(NoParameters())
        self.bad = bad

    def init(self, cells: Cells) -> State:
        return {"cell": np.arange(len(cells)), "steps": np.zeros(len(cells), dtype=np.int64)}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        if self.bad & set(state["cell"].tolist()):
            raise ValueError("bad")
        return {**state, "steps": state["steps"] + 1}, Outputs(np.ones((len(state["cell"]), 2)))


@given(st.sets(st.integers(0, N - 1), min_size=1), st.sets(st.integers(0, N - 1)))
def test_failures_of_cells_that_are_not_due_are_no_failures(due: set[int], bad: set[int]) -> None:
    board = Board(Raising(bad))
    before = board.init(CELLS)
    rows = np.array(sorted(due))
    after, outputs = board.compute_rows(
        rows, StepTime(0, np.array(0)), before, Inputs(np.zeros((N, 1), dtype=np.bool_))
    )
    assert set(outputs.failures) == due & bad
    assert all(isinstance(failure, FirmwareFailed) for failure in outputs.failures.values())
    well = np.array(sorted(due - bad), dtype=np.int64)
    others = np.array(sorted(set(range(N)) - due), dtype=np.int64)
    assert after.parts["firmware"]["steps"][well].tolist() == [1] * len(well)
    assert after.parts["firmware"]["steps"][others].tolist() == [0] * len(others)
    assert outputs.drive[well].tolist() == [[1.0, 1.0]] * len(well)
    assert not outputs.drive[others].any()
