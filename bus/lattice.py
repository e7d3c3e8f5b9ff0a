"""Which cells exist, in which order, and which cells are neighbours."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

NO_TICK_LIMIT: Final = int(np.iinfo(np.int64).max)
"""End tick of a live cell."""

SIDES = ("north", "east", "south", "west")
"""Sides in the order of every ``(n, 4)`` array; north is +row (+y), east is +column (+x)."""

OPPOSITE = (2, 3, 0, 1)
"""``OPPOSITE[side]``: the side on which a neighbour sees us."""

STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))
"""Row and column of the neighbour on each side, from one's own."""


@final
class Lattice:
    """The cells of an array in row-major order, and their four-neighbour links.

    Args:
        cells: ``(row, column)`` of every cell, in any order, each once.

    Attributes:
        rows: ``(n,)`` int64, row of each cell.
        columns: ``(n,)`` int64, column of each cell.
        neighbours: ``(n, 4)`` int64, index of the neighbour on each side of ``SIDES``, or -1.
    """

    def __init__(self, cells: Iterable[tuple[int, int]]) -> None:
        ordered = sorted(cells)
        if len(set(ordered)) != len(ordered):
            raise ValueError("a cell is named twice")
        self.cells: tuple[tuple[int, int], ...] = tuple(ordered)
        self._index = {cell: i for i, cell in enumerate(ordered)}
        self.rows: NDArray[np.int64] = np.array([r for r, _ in ordered], dtype=np.int64)
        self.columns: NDArray[np.int64] = np.array([c for _, c in ordered], dtype=np.int64)
        steps = np.array(STEPS)
        self.neighbours: NDArray[np.int64] = self.find(
            self.rows[:, None] + steps[:, 0], self.columns[:, None] + steps[:, 1]
        )

    def __len__(self) -> int:
        return len(self.cells)

    def index(self, cell: tuple[int, int]) -> int:
        """Index of the cell at ``(row, column)``; KeyError where there is none."""
        return self._index[cell]

    def find(self, rows: NDArray[np.int64], columns: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the indices of the cells at these rows and columns, of any shape; -1 where there is none."""
        if len(self) == 0:
            return np.full(np.shape(rows), -1)
        # one number a place, ascending like the cells; what lies outside the array has a number of no cell's
        first, width = int(self.columns.min()), int(np.ptp(self.columns)) + 2
        column = np.where((columns < first) | (columns >= first + width), first + width - 1, columns)
        places, wanted = self.rows * width + self.columns, rows * width + column
        found = np.minimum(np.searchsorted(places, wanted), len(self) - 1)
        return np.where(places[found] == wanted, found, -1)

    def __contains__(self, cell: object) -> bool:
        return cell in self._index
