"""Regions of cells in a scene's parameters: a single cell, or a block of rows and columns."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator, model_validator

from bus.lattice import Lattice
from cell_firmware.errors import Problem
from cell_firmware.specs import CellName, Finite, Spec, Vector

Index = Annotated[int, Field(ge=0)]
Ints = NDArray[np.int64]


class Region(Spec):
    """``cell = [r, c]``, or a block: ``rows = [first, last]`` and ``columns = [first, last]``, either or both.

    Both ends of a block belong to it; what it leaves out is all rows, or all columns.
    """

    cell: CellName | None = None
    """One cell."""
    rows: tuple[Index, Index] | None = None
    """First and last row of a block."""
    columns: tuple[Index, Index] | None = None
    """First and last column of a block."""

    @field_validator("rows", "columns")
    @classmethod
    def _ascends(cls, value: tuple[int, int] | None) -> tuple[int, int] | None:
        if value is not None and value[0] > value[1]:
            raise ValueError(f"must be the first and then the last, not [{value[0]}, {value[1]}]")
        return value

    @model_validator(mode="after")
    def _one_of_two(self) -> Region:
        if (self.cell is None) == (self.rows is None and self.columns is None):
            raise ValueError("give cell, or a block by rows, columns or both")
        return self

    def has(self, row: Ints, column: Ints) -> NDArray[np.bool_]:
        """Return whether the cell at this row and column is in the region, ``(n,)``."""
        if self.cell is not None:
            return (row == self.cell[0]) & (column == self.cell[1])
        among = np.ones(len(row), dtype=np.bool_)
        if self.rows is not None:
            among &= (row >= self.rows[0]) & (row <= self.rows[1])
        if self.columns is not None:
            among &= (column >= self.columns[0]) & (column <= self.columns[1])
        return among


class RegionValue(Region):
    """Cells, and a number for each of them."""

    value: Finite

    @property
    def amount(self) -> float:
        """Value of each cell."""
        return self.value


class RegionVelocity(Region):
    """Cells, and a speed for each of them."""

    speed_m_s: Vector

    @property
    def amount(self) -> tuple[float, float]:
        """Speed of each cell."""
        return self.speed_m_s


class RegionAssignment(Protocol):
    """Cells, and something for each of them."""

    @property
    def amount(self) -> Any:
        """Amount of each cell."""
        ...

    def has(self, row: Ints, column: Ints) -> NDArray[np.bool_]:
        """Return whether the cell at this row and column is in the region, ``(n,)``."""
        ...


def assign(
    named: Sequence[RegionAssignment], row: Ints, column: Ints, into: NDArray[Any]
) -> NDArray[np.bool_]:
    """Assign the amounts of regions ``into`` ``(n, ...)``; return which cells are in a region, ``(n,)``."""
    found = np.zeros(len(row), dtype=np.bool_)
    for place in named:
        mine = place.has(row, column)
        into[mine] = place.amount
        found |= mine
    return found


def region_problems(lattice: Lattice, named: Mapping[str, Sequence[Region]]) -> tuple[Problem, ...]:
    """Return the problems of regions on an array: no cell, or a cell of an earlier region in the list.

    Args:
        lattice: The cells.
        named: Lists of places, by the name of the parameter.
    """
    return tuple(problem for name, places in named.items() for problem in _misplaced(lattice, name, places))


def _misplaced(lattice: Lattice, name: str, places: Sequence[Region]) -> Iterator[Problem]:
    owner = np.full(len(lattice), -1)
    for i, place in enumerate(places):
        mine = place.has(lattice.rows, lattice.columns)
        if not mine.any():
            if place.cell is not None:
                row, column = place.cell
                yield Problem((name, i, "cell"), f"the array has no cell [{row}, {column}]", [row, column])
            else:
                yield Problem((name, i), "the array has no cell in this block")
        taken = np.flatnonzero(mine & (owner >= 0))
        if len(taken):
            first = int(taken[0])
            row, column = lattice.cells[first]
            yield Problem((name, i), f"names cell [{row}, {column}], as {name}[{owner[first]}] does")
        owner[mine] = i
