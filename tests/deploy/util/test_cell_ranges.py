"""Names of cells on the command line."""

from __future__ import annotations

import pytest

from deploy.errors import InputError
from deploy.util.cell_ranges import select_cells

CELLS = [(0, 0), (0, 1), (0, 2), (1, 0), (1, 2)]


@pytest.mark.parametrize(
    ("text", "chosen"),
    [
        ("all", [0, 1, 2, 3, 4]),
        ("0,1", [1]),
        ("1,2 0,0", [0, 4]),
        ("0,1-1,2", [1, 2, 4]),
        ("1,2-0,1", [1, 2, 4]),
        ("0,0-9,0 0,0", [0, 3]),
    ],
)
def test_cells_and_rectangles_are_selected_in_the_lattice_s_order(text: str, chosen: list[int]) -> None:
    assert select_cells(text, CELLS, "--cells").tolist() == chosen


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("1,1", "--cells 1,1: the array has no such cell"),
        (
            "0,0 a",
            "--cells a: must be all, a cell's row and column such as 1,2, or a rectangle such as 1,0-1,5",
        ),
        ("0;0", "--cells 0;0: must be all"),
        ("", "--cells: names no cell"),
    ],
)
def test_other_names_are_refused(text: str, problem: str) -> None:
    with pytest.raises(InputError, match=problem):
        select_cells(text, CELLS, "--cells")
