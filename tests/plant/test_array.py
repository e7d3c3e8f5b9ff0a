"""Where the cells are, and what lies beyond an edge of supports."""

from __future__ import annotations

import numpy as np
import pytest

from plant.array import CellArray
from plant.parcel_spec import ArraySpec


def test_the_array_is_centred_with_row_0_at_the_bottom_and_column_0_at_the_left() -> None:
    array = CellArray(ArraySpec(rows=2, columns=3, pitch_m=0.5))
    expected = [(-0.5, -0.25), (0.0, -0.25), (0.5, -0.25), (-0.5, 0.25), (0.0, 0.25), (0.5, 0.25)]
    assert array.positions_m.tolist() == [list(place) for place in expected]
    assert len(array) == 6
    assert array.origin_m == (-0.5, -0.25)


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (7, 20), (20, 7)])
def test_mirrored_cells_have_mirrored_positions_to_the_last_bit(rows: int, columns: int) -> None:
    positions = CellArray(ArraySpec(rows=rows, columns=columns, pitch_m=0.1)).positions_m
    assert np.array_equal(positions, -positions[::-1])


def test_missing_cells_leave_holes_and_move_nobody() -> None:
    full = CellArray(ArraySpec(rows=4, columns=5))
    holed = CellArray(ArraySpec(rows=4, columns=5, missing=((0, 0), (2, 3))))
    assert len(holed) == 18
    assert holed.grid[0, 0] == holed.grid[2, 3] == -1
    for index, cell in enumerate(holed.lattice.cells):
        assert holed.grid[cell] == index
        assert np.array_equal(holed.positions_m[index], full.positions_m[full.lattice.index(cell)])


def test_an_arbitrary_layout_keeps_its_place_in_the_whole_grid() -> None:
    array = CellArray(ArraySpec(rows=3, columns=3, pitch_m=1.0, cells=((2, 2), (0, 1))))
    assert array.lattice.cells == ((0, 1), (2, 2))
    assert array.positions_m.tolist() == [[0.0, -1.0], [1.0, 1.0]]


@pytest.mark.parametrize(
    ("edge", "towards", "beyond"),
    [
        (((0, 4), (3, 4)), (2.1, 0.0), False),  # the last column
        (((0, 3), (3, 3)), (1.1, 0.0), True),  # the last but one
        (((0, 3), (3, 3)), (0.9, 0.0), True),  # the same, to the other side
        (((3, 0), (3, 4)), (0.0, 1.6), False),  # the last row
        (((0, 1), (1, 0)), (-1.6, -1.1), True),  # a diagonal with the corner cell beyond
        (((1, 4), (3, 2)), (1.1, 1.1), True),  # a diagonal with cells beyond
        (((3, 4), (3, 4)), (2.1, 1.5), False),  # one cell, at the corner
        (((3, 4), (3, 4)), (1.9, 1.5), True),  # the same, towards its neighbour
        (((3, 4), (3, 4)), (2.0, 1.5), False),  # nowhere
    ],
)
def test_cells_beyond_an_edge_are_distinguished_from_the_arrays_rim(
    edge: tuple[tuple[int, int], tuple[int, int]], towards: tuple[float, float], beyond: bool
) -> None:
    array = CellArray(ArraySpec(rows=4, columns=5, pitch_m=1.0))
    a, b = (array.lattice.index(cell) for cell in edge)
    assert array.cells_beyond(a, b, np.array(towards)) is beyond
    assert array.cells_beyond(b, a, np.array(towards)) is beyond


def test_cells_across_a_hole_count_as_beyond() -> None:
    ring = tuple((r, c) for r in range(1, 4) for c in range(1, 4))
    array = CellArray(ArraySpec(rows=5, columns=5, pitch_m=1.0, missing=ring))
    a, b = array.lattice.index((1, 0)), array.lattice.index((3, 0))
    assert array.cells_beyond(a, b, np.array([-1.9, 0.0]))
