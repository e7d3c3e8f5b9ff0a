"""Array of cells in the plant: positions, and neighbours beyond each edge."""

from __future__ import annotations

from functools import cached_property
from typing import final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from plant.parcel_spec import ArraySpec


@final
class CellArray:
    """Cells on a square lattice centred on the origin.

    Attributes:
        lattice: which cells exist, in row-major order.
        pitch_m: distance of neighbouring cells.
        positions_m: ``(n, 2)`` cell centres.
        grid: ``(rows, columns)`` int64, index of each cell or -1; of those only that are there now.
        origin_m: centre of cell (0, 0), whether it exists or not.
        sensors_m: ``(s, 2)`` presence sensors relative to a cell's centre.
    """

    def __init__(self, spec: ArraySpec) -> None:
        self.lattice: Lattice = spec.lattice()
        self.pitch_m: float = spec.pitch_m
        self.origin_m: tuple[float, float] = (
            -0.5 * (spec.columns - 1) * spec.pitch_m,
            -0.5 * (spec.rows - 1) * spec.pitch_m,
        )
        rows, columns = self.lattice.rows, self.lattice.columns
        # from the middle outward, so that mirrored cells have mirrored coordinates to the last bit
        self.positions_m: NDArray[np.float64] = np.empty((len(self.lattice), 2))
        self.positions_m[:, 0] = 0.5 * (2 * columns - (spec.columns - 1)) * spec.pitch_m
        self.positions_m[:, 1] = 0.5 * (2 * rows - (spec.rows - 1)) * spec.pitch_m
        self.grid: NDArray[np.int64] = np.full((spec.rows, spec.columns), -1, dtype=np.int64)
        self.grid[rows, columns] = np.arange(len(self.lattice), dtype=np.int64)
        self.sensors_m: NDArray[np.float64] = np.array(spec.sensors_m, dtype=np.float64).reshape(-1, 2)

    def __len__(self) -> int:
        return len(self.lattice)

    @cached_property
    def far_m(self) -> float:
        """Greatest coordinate of a cell, along either axis and either way, m."""
        return float(np.max(np.abs(self.positions_m)))

    @cached_property
    def sensor_reach_m(self) -> float:
        """How far a presence sensor is from its cell's centre at most."""
        return float(np.max(np.hypot(self.sensors_m[:, 0], self.sensors_m[:, 1])))

    def keep(self, there: NDArray[np.bool_]) -> NDArray[np.int64]:
        """Take cells out of the array, or put them back: ``there`` ``(n,)`` says which have their place in it now.

        The grid is changed as it stands: whoever looks cells up in it finds no others from now on.

        Returns:
            Those that have come or gone, ascending.
        """
        places = self.lattice.rows, self.lattice.columns
        moved = np.flatnonzero((self.grid[places] >= 0) != there)
        self.grid[places] = np.where(there, np.arange(len(self)), -1)
        return moved

    def near(self, centre_m: NDArray[np.float64], reach_m: float) -> NDArray[np.int64]:
        """The cells less than ``reach_m`` from a point ``(2,)``, ascending."""
        cells = self.within(centre_m, reach_m)
        away = self.positions_m[cells] - centre_m
        return cells[np.hypot(away[:, 0], away[:, 1]) < reach_m]

    def within(self, centre_m: NDArray[np.float64], reach_m: float) -> NDArray[np.int64]:
        """The cells less than ``reach_m`` from a point ``(2,)`` along x and along y, and a few more; ascending."""
        most = np.array(self.grid.shape[::-1])
        low = np.floor((centre_m - reach_m - self.origin_m) / self.pitch_m) - 1.0
        high = np.ceil((centre_m + reach_m - self.origin_m) / self.pitch_m) + 2.0
        left, below = np.clip(low, 0, most).astype(np.int64)
        right, above = np.clip(high, 0, most).astype(np.int64)
        near = self.grid[below:above, left:right]
        return np.sort(near[near >= 0])

    def cells_beyond(self, a: int, b: int, towards_m: NDArray[np.float64]) -> bool:
        """Whether any cell lies across the edge from cell ``a`` to ``b``, on the side of ``towards_m`` ``(2,)``.

        Looks along the edge's span, widened by half a pitch: the strip onto which a parcel tips. With ``a`` equal
        to ``b`` the edge is a point, and the strip runs from it towards ``towards_m``.
        """
        p, q = self.positions_m[a], self.positions_m[b]
        along = q - p if a != b else np.array([towards_m[1] - p[1], p[0] - towards_m[0]])
        length = float(np.hypot(along[0], along[1]))
        if length == 0.0:
            return False
        along = along / length
        length = 0.0 if a == b else length
        outward = np.array([along[1], -along[0]])
        if outward @ (towards_m - p) < 0.0:
            outward = -outward
        offset = self.positions_m[self.grid[self.grid >= 0]] - p
        beyond = offset @ outward > 1e-9 * self.pitch_m
        span = offset @ along
        beside = (span > -0.5 * self.pitch_m) & (span < length + 0.5 * self.pitch_m)
        return bool(np.any(beyond & beside))
