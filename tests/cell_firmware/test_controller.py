"""The memory of cells taken apart and put together again, against plain indexing."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.lattice import Lattice
from cell_firmware.controller import ControllerState
from cell_firmware.firmware import Cells

ROWS = np.array([0, 2, 3])
STRUCTURE = np.dtype([("x", "<f8"), ("flag", "?")])


def structures(n: int) -> NDArray[Any]:
    made = np.zeros((n, 4), dtype=STRUCTURE)
    made["x"] = np.arange(4.0 * n).reshape(n, 4)
    made["flag"] = np.arange(n)[:, None] % 2 == 0
    return made


def objects(n: int) -> NDArray[Any]:
    made = np.empty(n, dtype=object)
    made[:] = [{"number": i} for i in range(n)]
    return made


KINDS: dict[str, Callable[[int], NDArray[Any]]] = {
    "integers": np.arange,
    "bits": lambda n: (np.arange(4 * n) % 3 == 0).reshape(n, 4),
    "pairs": lambda n: np.arange(2.0 * n).reshape(n, 2),
    "blocks": lambda n: np.arange(6.0 * n).reshape(n, 2, 3),
    "columns": lambda n: np.arange(6.0 * n).reshape(2, 3, n).transpose(2, 1, 0),  # rows not in one piece
    "structures": structures,
    "objects": objects,
}


def state_of(cells: Cells, array: NDArray[Any]) -> ControllerState:
    array.setflags(write=False)
    return ControllerState(cells, {"part": {"array": array}})


@pytest.mark.parametrize("kind", KINDS)
def test_rows_are_taken_and_put_back_as_by_plain_indexing(
    kind: str, grid: Callable[..., Lattice], everything: Callable[..., Cells]
):
    cells, array = everything(grid(1, 5)), KINDS[kind](5)
    state = state_of(cells, array)
    taken = state.take(ROWS)
    assert taken.cells.column.tolist() == ROWS.tolist()
    np.testing.assert_array_equal(taken.parts["part"]["array"], array[ROWS])
    assert taken.parts["part"]["array"].dtype == array.dtype

    other = KINDS[kind](8)[5:]
    wanted = array.copy()
    wanted[ROWS] = other
    put = state.put(ROWS, state_of(cells.take(ROWS), other)).parts["part"]["array"]
    np.testing.assert_array_equal(put, wanted)
    assert put.dtype == array.dtype
    np.testing.assert_array_equal(array, KINDS[kind](5))  # what was there stays as it was


def test_numbers_of_cells_that_go_over_to_another_type_are_kept(
    grid: Callable[..., Lattice], everything: Callable[..., Cells]
):
    cells = everything(grid(1, 5))
    state = state_of(cells, np.arange(5))
    put = state.put(ROWS, state_of(cells.take(ROWS), np.full(3, 0.5))).parts["part"]["array"]
    assert put.tolist() == [0.5, 1.0, 0.5, 0.5, 4.0]
