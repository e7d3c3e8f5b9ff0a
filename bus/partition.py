"""How a lattice is cut into shards, and which links stay inside one and which cross a border."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from bus.errors import PartitionError
from bus.lattice import OPPOSITE, Lattice

Index = NDArray[np.int64]


@final
@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Directed links between neighbours; every array is ``(m,)`` int64.

    ``source`` and ``target`` are indices of cells in the lattice, ``source_side`` the side towards which the
    source sends, ``target_side`` the side from which the target receives. In ascending order of
    (other shard, source, source side).
    """

    source: Index
    source_side: Index
    target: Index
    target_side: Index

    def __len__(self) -> int:
        return len(self.source)


@final
@dataclass(frozen=True, slots=True)
class Border:
    """The stretch ``[start, stop)`` of a shard's outgoing or incoming links shared with one other shard."""

    shard: int
    start: int
    stop: int


@final
class Partition:
    """A cut of a lattice into shards: every cell in exactly one.

    Args:
        lattice: The cells.
        shards: Indices of each shard's cells, ascending.

    Attributes:
        lattice: The cells.
        count: Number of shards.
        shard_of: ``(n,)`` int64, shard of each cell.
        position: ``(n,)`` int64, place of each cell inside its shard.

    Raises:
        PartitionError: An empty shard, a cell in none or in two, indices that do not ascend.
    """

    def __init__(self, lattice: Lattice, shards: Sequence[Sequence[int] | Index]) -> None:
        self.lattice = lattice
        self.count = len(shards)
        self._cells = tuple(np.asarray(cells, dtype=np.int64) for cells in shards)
        n = len(lattice)
        self.shard_of: Index = np.full(n, -1, dtype=np.int64)
        self.position: Index = np.zeros(n, dtype=np.int64)
        for shard, cells in enumerate(self._cells):
            if not len(cells):
                raise PartitionError(f"shard {shard} has no cells")
            if cells[0] < 0 or cells[-1] >= n or np.any(cells[1:] <= cells[:-1]):
                raise PartitionError(f"shard {shard}: cells must ascend within 0..{n - 1}")
            if np.any(self.shard_of[cells] >= 0):
                raise PartitionError(f"shard {shard} holds a cell that another shard holds already")
            self.shard_of[cells] = shard
            self.position[cells] = np.arange(len(cells))
        if np.any(self.shard_of < 0):
            row, column = lattice.cells[int(np.argmin(self.shard_of))]
            raise PartitionError(f"cell {row},{column} is in no shard")
        source, side = np.nonzero(lattice.neighbours >= 0)
        self._source: Index = source.astype(np.int64)
        self._side: Index = side.astype(np.int64)
        self._target: Index = lattice.neighbours[source, side]

    @classmethod
    def even(cls, lattice: Lattice, count: int) -> Partition:
        """``count`` runs of consecutive cells in row-major order, their sizes within one of each other.

        Raises:
            PartitionError: ``count`` is not within 1 and the number of cells.
        """
        if not 1 <= count <= len(lattice):
            raise PartitionError(f"{count} shards: must be 1..{len(lattice)}, the number of cells")
        return cls(lattice, np.array_split(np.arange(len(lattice)), count))

    @classmethod
    def each(cls, lattice: Lattice) -> Partition:
        """One shard a cell."""
        return cls.even(lattice, len(lattice))

    def cells(self, shard: int) -> Index:
        """Indices of the shard's cells, ascending: row-major."""
        return self._cells[shard]

    def inside(self, shard: int) -> Links:
        """Links whose two cells are both in the shard."""
        mine = self.shard_of[self._source] == shard
        return self._links(mine & (self.shard_of[self._target] == shard), self._source)

    def outgoing(self, shard: int) -> Links:
        """Links from the shard into others, in order of (target's shard, source, side)."""
        mine = self.shard_of[self._source] == shard
        return self._links(mine & (self.shard_of[self._target] != shard), self._target)

    def incoming(self, shard: int) -> Links:
        """Links from other shards into this one, in order of (source's shard, source, side)."""
        mine = self.shard_of[self._target] == shard
        return self._links(mine & (self.shard_of[self._source] != shard), self._source)

    def outgoing_borders(self, shard: int) -> tuple[Border, ...]:
        """Return the ranges of ``outgoing(shard)``, one for each receiving shard."""
        return _borders(self.shard_of[self.outgoing(shard).target])

    def incoming_borders(self, shard: int) -> tuple[Border, ...]:
        """Return the ranges of ``incoming(shard)``, one for each sending shard; both ends use the same order."""
        return _borders(self.shard_of[self.incoming(shard).source])

    def _links(self, chosen: NDArray[np.bool_], other_end: Index) -> Links:
        index = np.nonzero(chosen)[0]
        index = index[np.lexsort((self._side[index], self._source[index], self.shard_of[other_end[index]]))]
        side = self._side[index]
        return Links(self._source[index], side, self._target[index], np.array(OPPOSITE, dtype=np.int64)[side])


def _borders(shards: Index) -> tuple[Border, ...]:
    names, starts, sizes = np.unique(shards, return_index=True, return_counts=True)
    return tuple(
        Border(int(name), int(start), int(start + size))
        for name, start, size in zip(names, starts, sizes, strict=True)
    )
