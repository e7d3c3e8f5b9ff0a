"""Geometry of the map: image of the cells, arrows, outlines, trails."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from deploy.view.source import Floats, Ints

MOST_DETAILED: Final = 2_500
"""Most cells in sight that are drawn one by one, with arrows; more would be under a few pixels each."""
_TRAIL_POINTS: Final = 60
"""Points of a parcel's trail."""


@final
class CellGrid:
    """Places of the cells.

    Args:
        cells: ``(row, column)`` of every cell.
        positions_m: Centre of every cell.
        pitch_m: Distance of neighbouring cells, m.

    Attributes:
        centres: ``(n, 2)`` centres, m.
        pitch_m: As given.
        low: Lower left corner of the image, m.
        size: Width and height of the image, m.
    """

    def __init__(
        self, cells: Sequence[Sequence[int]], positions_m: Sequence[Sequence[float]], pitch_m: float
    ) -> None:
        places = np.array(cells, dtype=np.int64).reshape(-1, 2)
        self.centres: Floats = np.array(positions_m, dtype=np.float64).reshape(-1, 2)
        self.pitch_m = pitch_m
        self._first = places.min(axis=0)
        self._shape = tuple((places.max(axis=0) - self._first + 1).tolist())
        self._rows, self._columns = (places - self._first).T
        self.low = self.centres.min(axis=0) - pitch_m / 2
        self.size = self.centres.max(axis=0) + pitch_m / 2 - self.low
        self._index = np.full(self._shape, -1, dtype=np.int64)
        self._index[self._rows, self._columns] = np.arange(len(places))

    def image(self, colours: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """Return the image of the cells, ``(rows, columns)``, transparent where there is no cell."""
        image = np.zeros(self._shape, dtype=np.uint32)
        image[self._rows, self._columns] = colours
        return image

    def cell_at(self, x: float, y: float) -> int | None:
        """Return the cell at a place; None if there is none."""
        column, row = np.floor((np.array([x, y]) - self.low) / self.pitch_m).astype(np.int64).tolist()
        if not (0 <= row < self._shape[0] and 0 <= column < self._shape[1]):
            return None
        found = int(self._index[row, column])
        return None if found < 0 else found

    def neighbour(self, cell: int, rows: int, columns: int) -> int | None:
        """Return the nearest cell in a direction, over holes; None at the edge."""
        row, column = int(self._rows[cell]) + rows, int(self._columns[cell]) + columns
        while 0 <= row < self._shape[0] and 0 <= column < self._shape[1]:
            if self._index[row, column] >= 0:
                return int(self._index[row, column])
            row, column = row + rows, column + columns
        return None

    def beside(self, cell: int) -> dict[str, int]:
        """Return the neighbours of a cell by side."""
        found: dict[str, int] = {}
        for side, (rows, columns) in {
            "north": (1, 0),
            "east": (0, 1),
            "south": (-1, 0),
            "west": (0, -1),
        }.items():
            row, column = int(self._rows[cell]) + rows, int(self._columns[cell]) + columns
            if 0 <= row < self._shape[0] and 0 <= column < self._shape[1] and self._index[row, column] >= 0:
                found[side] = int(self._index[row, column])
        return found

    def in_sight(self, left: float, right: float, bottom: float, top: float) -> Ints:
        """Return the cells in a view, by index."""
        x, y = self.centres.T
        half = self.pitch_m / 2
        inside = (x > left - half) & (x < right + half) & (y > bottom - half) & (y < top + half)
        return np.flatnonzero(inside)


def arrows(centres: Floats, speeds: Floats, fastest: float, pitch_m: float) -> dict[str, Floats]:
    """Return the wheel velocities as shafts and heads, each about its cell's centre.

    Args:
        centres: ``(k, 2)`` centres, m.
        speeds: ``(k, 2)`` surface speeds, m/s.
        fastest: Speed of an arrow as long as a cell, m/s.
        pitch_m: Distance of neighbouring cells, m.
    """
    size = np.hypot(speeds[:, 0], speeds[:, 1])
    moving = (
        np.isfinite(size) & (size > 0.02 * fastest) if fastest > 0 else np.zeros(len(size), dtype=np.bool_)
    )
    half = 0.42 * pitch_m * speeds[moving] / fastest if fastest > 0 else np.zeros((0, 2))
    tail, head = centres[moving] - half, centres[moving] + half
    return {
        "x0": tail[:, 0],
        "y0": tail[:, 1],
        "x1": head[:, 0],
        "y1": head[:, 1],
        "angle": np.arctan2(half[:, 1], half[:, 0]) - np.pi / 2,
    }


def outline(footprint: Floats, state: Floats) -> Floats:
    """Return the corners of a footprint at a pose, ``(v, 2)``."""
    cosine, sine = np.cos(state[2]), np.sin(state[2])
    return footprint @ np.array([[cosine, sine], [-sine, cosine]]) + state[:2]


def outlines(footprints: Sequence[Floats], states: Floats) -> tuple[list[list[float]], list[list[float]]]:
    """Return x and y of the corners of every parcel, as lists; an absent parcel has none."""
    xs: list[list[float]] = []
    ys: list[list[float]] = []
    for footprint, state in zip(footprints, states, strict=True):
        corners = outline(footprint, state) if np.isfinite(state).all() else np.zeros((0, 2))
        xs.append(corners[:, 0].tolist())
        ys.append(corners[:, 1].tolist())
    return xs, ys


def broken_line(pieces: Sequence[Floats]) -> tuple[Floats, Floats]:
    """Join lines, ``(k, 2)`` each, to one with gaps of NaN: one glyph and two arrays, however many lines."""
    if not pieces:
        return np.zeros(0), np.zeros(0)
    gap = np.full((1, 2), np.nan)
    joined = np.concatenate([part for piece in pieces for part in (piece, gap)])
    return joined[:, 0], joined[:, 1]


def closed(corners: Floats) -> Floats:
    """Return a polygon as a line that ends where it begins."""
    return np.concatenate([corners, corners[:1]])


def trails(states: Floats, index: int, reach: int) -> list[Floats]:
    """Return the parcels' paths over the last ``reach`` instants, thinned out."""
    first = max(0, index - reach)
    step = max(1, -(-(index - first) // _TRAIL_POINTS))
    rows = np.append(np.arange(first - first % step, index, step), index)
    paths = states[rows[rows >= 0], :, :2]
    return [paths[:, parcel] for parcel in range(paths.shape[1])]
