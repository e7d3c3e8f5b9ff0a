"""Neighbours on any set of cells."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from bus.lattice import SIDES, Lattice

CELLS = st.sets(st.tuples(st.integers(0, 6), st.integers(0, 6)), max_size=40)


@given(CELLS)
def test_every_cell_has_the_neighbours_that_exist(cells: set[tuple[int, int]]) -> None:
    lattice = Lattice(cells)
    named = {"north": (1, 0), "east": (0, 1), "south": (-1, 0), "west": (0, -1)}
    assert lattice.neighbours.shape == (len(cells), 4)
    for (row, column), neighbours in zip(lattice.cells, lattice.neighbours.tolist(), strict=True):
        for side, found in zip(SIDES, neighbours, strict=True):
            wanted = (row + named[side][0], column + named[side][1])
            assert (lattice.cells[found] if found >= 0 else None) == (wanted if wanted in cells else None)


@given(CELLS, st.lists(st.tuples(st.integers(-3, 9), st.integers(-9, 15)), min_size=1, max_size=20))
def test_cells_are_found_by_row_and_column_and_nothing_where_there_is_none(
    cells: set[tuple[int, int]], places: list[tuple[int, int]]
) -> None:
    lattice, (rows, columns) = Lattice(cells), np.array(places).T
    found = lattice.find(rows[:, None], columns[:, None])
    assert found.shape == (len(places), 1)
    assert found[:, 0].tolist() == [lattice.index(cell) if cell in cells else -1 for cell in places]
