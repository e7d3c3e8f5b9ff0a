"""Fault ``partition``: a line through the array that no message crosses."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from bus.fault import FaultInstance, Problem, links_of
from bus.lattice import SIDES, Lattice
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.kinds.link_down import Cut
from cell_firmware.faults.links import AffectedLinks, LinkFault, LinkFilter

Line = Annotated[int, Field(ge=0)]


@final
class PartitionFault(LinkFault):
    """All links across a line are cut, in both directions. The line is north of a row or east of a column."""

    kind_name: ClassVar[str] = "partition"
    kind: Literal["partition"] = "partition"
    row: Line | None = None
    """Row south of the line."""
    column: Line | None = None
    """Column west of the line, instead of ``row``."""

    @model_validator(mode="after")
    def _one_line(self) -> Self:
        if (self.row is None) == (self.column is None):
            raise ValueError("give row or column, one of the two")
        return self

    def problems(self, lattice: Lattice) -> Iterator[Problem]:
        """Yield a line that no link crosses."""
        if not len(self.affected_cells(lattice, 0, 0)):
            name = "row" if self.column is None else "column"
            yield (
                (name,),
                getattr(self, name),
                f"no two cells are neighbours across the line behind this {name}",
            )

    def affected_cells(self, lattice: Lattice, seed: int, number: int) -> NDArray[np.int64]:
        """The cells on both sides of the line, ascending."""
        return np.unique(self.affected_links(lattice, seed, number)[:, 0])

    def affected_links(self, lattice: Lattice, seed: int, number: int) -> NDArray[np.int64]:
        """Return the links across the line; see ``LinkFault.affected_links``."""
        del seed, number
        side = "north" if self.column is None else "east"
        near = lattice.rows == self.row if self.column is None else lattice.columns == self.column
        return links_of(lattice, np.flatnonzero(near), (SIDES.index(side),), incoming=True, outgoing=True)

    def make_filter(self, links: AffectedLinks, injected: FaultInstance[CellFault]) -> LinkFilter:
        """Return a filter that drops all messages."""
        return Cut(links, injected)
