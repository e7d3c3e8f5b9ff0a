"""Tiles: square blocks of cells for one parcel each, and one-way lanes in between."""

from __future__ import annotations

from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from typing import Annotated, Any, Final, Literal, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from bus.lattice import OPPOSITE, SIDES, STEPS, Lattice
from cell_firmware.errors import Problem
from cell_firmware.firmware import Bools, Cells
from cell_firmware.specs import CellName, Spec

Ints = NDArray[np.int64]
Tile = tuple[int, int]

_UNUSED: Final = "-"
_LAST: Final = "."
_LETTERS: Final = {side[0]: number for number, side in enumerate(SIDES)}


class ExitTile(Spec):
    """Exit of the array: a tile, and the side over which parcels leave."""

    tile: CellName
    side: Literal["north", "east", "south", "west"]


class TilesSpec(Spec):
    """Tiles of an array, one-way lanes between tiles, and exits."""

    tile_cells: Annotated[int, Field(ge=3, le=4)] = 4
    """Cells along a tile's side."""
    lanes: Annotated[tuple[str, ...], Field(min_length=1)]
    """A line for each row of tiles, the northernmost first; in it a word for each tile: the sides, of ``nesw``, over
    which it may pass parcels on; ``.`` for none, ``-`` for a place where there is no tile."""
    exits: Annotated[tuple[ExitTile, ...], Field(min_length=1, max_length=8)]
    """Exits 1, 2, ... in their order."""

    @model_validator(mode="after")
    def _lanes_lead_somewhere(self) -> TilesSpec:
        words = [line.split() for line in self.lanes]
        if any(len(row) != len(words[0]) for row in words):
            raise ValueError("lanes must have as many words in every line")
        for word in (word for row in words for word in row):
            if word not in (_UNUSED, _LAST) and (set(word) - set(_LETTERS) or len(set(word)) < len(word)):
                raise ValueError(f"lanes: {word!r} is none of {_UNUSED!r}, {_LAST!r} and letters of 'nesw'")
        Tiling(self)
        return self


@final
class Tiling:
    """The tiles of a scene.

    Args:
        spec: How they are cut.

    Attributes:
        side: Cells along a tile's side.
        used: ``(rows, columns)``, whether there is a tile.
        out: ``(rows, columns, 4)``, whether the tile may pass parcels on over the side.
        into: ``(rows, columns, 4)``, whether the tile may receive parcels over the side.
        exit: ``(rows, columns)``, number of the exit at the tile, from 1; 0 where there is none.
        exit_side: ``(rows, columns)``, side over which parcels leave at the exit.

    Raises:
        ValueError: A lane leads where there is no tile, lanes form a ring, or an exit is no tile or named twice.
    """

    def __init__(self, spec: TilesSpec) -> None:
        words = [line.split() for line in reversed(spec.lanes)]
        self.side = spec.tile_cells
        self.shape = (len(words), len(words[0]))
        self.used: Bools = np.array([[word != _UNUSED for word in row] for row in words])
        self.out: Bools = np.zeros((*self.shape, 4), dtype=np.bool_)
        self.into: Bools = np.zeros((*self.shape, 4), dtype=np.bool_)
        for row, column in self.tiles():
            for letter in words[row][column].strip(_LAST):
                self._lay((row, column), _LETTERS[letter])
        self.exit: Ints = np.zeros(self.shape, dtype=np.int64)
        self.exit_side: Ints = np.zeros(self.shape, dtype=np.int64)
        for number, exit_ in enumerate(spec.exits, 1):
            if not self._is_tile(exit_.tile) or self.exit[exit_.tile]:
                what = "is an exit already" if self._is_tile(exit_.tile) else "is none"
                raise ValueError(f"exits: tile [{exit_.tile[0]}, {exit_.tile[1]}] {what}")
            self.exit[exit_.tile] = number
            self.exit_side[exit_.tile] = SIDES.index(exit_.side)
        self._check_rings()

    def tiles(self) -> Iterator[Tile]:
        """Row and column of every tile, row by row."""
        return ((int(row), int(column)) for row, column in np.argwhere(self.used))

    def onward(self, tile: Tile) -> Iterator[Tile]:
        """Yield the tiles to which a tile may pass parcels on."""
        for side in np.flatnonzero(self.out[tile]).tolist():
            yield tile[0] + STEPS[side][0], tile[1] + STEPS[side][1]

    def _is_tile(self, tile: Tile) -> bool:
        inside = 0 <= tile[0] < self.shape[0] and 0 <= tile[1] < self.shape[1]
        return inside and bool(self.used[tile])

    def _lay(self, tile: Tile, side: int) -> None:
        to = tile[0] + STEPS[side][0], tile[1] + STEPS[side][1]
        if not self._is_tile(to):
            raise ValueError(f"lanes: the lane {SIDES[side]} of tile [{tile[0]}, {tile[1]}] leads to no tile")
        self.out[tile][side] = True
        self.into[to][OPPOSITE[side]] = True

    def _check_rings(self) -> None:
        """Without a ring, some parcel can always go on: see ``docs/protocols/routing.md``."""
        try:
            TopologicalSorter({tile: list(self.onward(tile)) for tile in self.tiles()}).prepare()
        except CycleError as error:
            ring = " - ".join(f"[{row}, {column}]" for row, column in reversed(error.args[1]))
            raise ValueError(f"lanes: a ring, on which parcels might wait for each other: {ring}") from None

    def problems(self, lattice: Lattice) -> Iterator[Problem]:
        """Yield tiles with a cell that the array does not have."""
        for tile in self.tiles():
            for cell in self.cells(tile):
                if cell not in lattice:
                    lacks = f"the array has no cell [{cell[0]}, {cell[1]}] of tile [{tile[0]}, {tile[1]}]"
                    yield Problem(("lanes",), f"{lacks}; write {_UNUSED!r} where there is no tile")
                    break

    def cells(self, tile: Tile) -> Iterator[tuple[int, int]]:
        """Row and column of every cell of a tile."""
        for row in range(self.side):
            for column in range(self.side):
                yield tile[0] * self.side + row, tile[1] * self.side + column

    def place(self, cells: Cells) -> dict[str, NDArray[Any]]:
        """Return the place of cells in their tiles, arrays by name; rows of cells outside tiles are zero."""
        row, column = cells.row // self.side, cells.column // self.side
        inside = (row < self.shape[0]) & (column < self.shape[1])
        at = np.where(inside, row, 0), np.where(inside, column, 0)
        used = inside & self.used[at]
        local = (cells.row % self.side, cells.column % self.side)
        middle = 0.5 * (self.side - 1)
        offset = np.stack((local[1] - middle, local[0] - middle), axis=1) * cells.pitch_m
        steps = np.array(STEPS)
        there = local[0][:, None] + steps[:, 0], local[1][:, None] + steps[:, 1]
        mates = (np.minimum(*there) >= 0) & (np.maximum(*there) < self.side)
        return {
            "used": used,
            "rank": np.where(used, _ranks(self.side)[local], 0),
            "bit": np.where(used, 1 << (local[0] * self.side + local[1]), 0),
            "mate": mates & used[:, None],
            "out": self.out[at] & ~mates & used[:, None],
            "into": self.into[at] & used[:, None],
            "exit": np.where(used, self.exit[at], 0),
            "exit_side": self.exit_side[at],
            "offset_m": offset,
        }


def _ranks(side: int) -> Ints:
    """Return the rank of each cell of a tile for leadership, ``(side, side)``; cells near the middle first."""
    across = np.arange(side) - 0.5 * (side - 1)
    away = across[:, None] * across[:, None] + across * across
    ranks = np.empty(side * side, dtype=np.int64)
    ranks[np.argsort(away.ravel(), kind="stable")] = np.arange(side * side)
    return ranks.reshape(side, side)
