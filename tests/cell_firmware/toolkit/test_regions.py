from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from bus.lattice import Lattice
from cell_firmware.toolkit.regions import Region, RegionValue, assign, region_problems

GRID = Lattice((r, c) for r in range(4) for c in range(5) if (r, c) != (1, 1))


def cells(**given: Any) -> list[tuple[int, int]]:
    place = Region.model_validate(given)
    return [
        cell for cell, has in zip(GRID.cells, place.has(GRID.rows, GRID.columns).tolist(), strict=True) if has
    ]


def test_a_block_has_both_its_ends_and_what_it_leaves_out_is_all_of_it() -> None:
    assert cells(cell=[2, 3]) == [(2, 3)]
    assert cells(rows=[1, 2], columns=[1, 2]) == [(1, 2), (2, 1), (2, 2)]
    assert cells(rows=[3, 3]) == [(3, c) for c in range(5)]
    assert cells(columns=[4, 4]) == [(r, 4) for r in range(4)]


@pytest.mark.parametrize(
    ("given", "rule"),
    [
        ({}, "give cell, or a block"),
        ({"cell": [0, 0], "rows": [0, 1]}, "give cell, or a block"),
        ({"rows": [2, 1]}, r"must be the first and then the last, not \[2, 1\]"),
        ({"columns": [-1, 1]}, "greater than or equal to 0"),
    ],
)
def test_what_is_neither_a_cell_nor_a_block_is_refused(given: dict[str, Any], rule: str) -> None:
    with pytest.raises(ValidationError, match=rule):
        Region.model_validate(given)


def test_places_without_cells_and_cells_with_two_places_are_all_reported() -> None:
    named = [
        RegionValue.model_validate(item)
        for item in (
            {"cell": [1, 1], "value": 1.0},
            {"rows": [7, 9], "value": 1.0},
            {"rows": [0, 1], "value": 1.0},
            {"cell": [1, 2], "value": 2.0},
        )
    ]
    assert [str(problem) for problem in region_problems(GRID, {"held": named, "initial": named[2:3]})] == [
        "held[0].cell: the array has no cell [1, 1]",
        "held[1]: the array has no cell in this block",
        "held[3]: names cell [1, 2], as held[2] does",
    ]


def test_values_are_laid_where_their_places_are() -> None:
    into = np.full(len(GRID), -1.0)
    named = [RegionValue.model_validate({"rows": [3, 3], "value": 2.5}), RegionValue(cell=(0, 0), value=4.0)]
    mine = assign(named, GRID.rows, GRID.columns, into)
    assert into.tolist() == np.where(GRID.rows == 3, 2.5, np.where(np.arange(19) == 0, 4.0, -1.0)).tolist()
    assert (mine == (into > 0)).all()
