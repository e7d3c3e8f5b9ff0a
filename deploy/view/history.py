"""Instants of a run in progress, kept within a limit of memory."""

from __future__ import annotations

from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from deploy.view.source import Floats, Instant, Ints

_BYTES: Final = 256 * 1024 * 1024
"""Memory of the instants kept."""
_MOST: Final = 20_000
"""Most instants kept: half an hour at 12 frames a second."""


@final
class History:
    """The last instants of a run, in the order of time; the older half is thinned out when memory ends.

    Args:
        cells: Number of cells.
        parcels: Number of parcels.
        most: Most instants kept; None: as many as fit the memory.
    """

    def __init__(self, cells: int, parcels: int, most: int | None = None) -> None:
        each = 16 * cells + 48 * parcels
        self._most = most or max(100, min(_MOST, _BYTES // max(1, each)))
        self._instants: list[Instant] = []
        self._times: Floats = np.zeros(64)
        self._states: Floats = np.zeros((64, parcels, 6))

    @property
    def times_s(self) -> Floats:
        """``(T,)`` simulated times."""
        return self._times[: len(self._instants)]

    @property
    def states(self) -> Floats:
        """``(T, m, 6)`` states of the parcels."""
        return self._states[: len(self._instants)]

    def at(self, index: int) -> Instant:
        """Return one instant."""
        return self._instants[index]

    def speeds_of(self, cell: int, indices: Ints) -> Floats:
        """Return the wheel speeds of a cell, ``(k, 2)``."""
        rows: list[list[float]] = [self.at(int(index)).wheel_speeds[cell].tolist() for index in indices]
        return np.array(rows, dtype=np.float64).reshape(-1, 2)

    def add(self, instant: Instant) -> bool:
        """Add an instant; those at its time or later are dropped.

        Returns:
            Whether all instants that were there are still there and in their place.
        """
        last = self._instants[-1] if self._instants else None
        kept = int(np.searchsorted(self.times_s, instant.time_s, side="left"))
        if last is not None and kept == len(self._instants) - 1 and instant.tick == last.tick:
            self._put(kept, instant)  # the same tick again: a paused run, perhaps with a parcel moved
            return bool(np.array_equal(last.parcels, instant.parcels, equal_nan=True))
        dropped = kept < len(self._instants)
        del self._instants[kept:]
        if len(self._instants) >= self._most:
            self._thin()
            dropped = True
        self._put(len(self._instants), instant)
        return not dropped

    def _put(self, index: int, instant: Instant) -> None:
        if index == len(self._times):
            self._times = np.concatenate([self._times, np.zeros_like(self._times)])
            self._states = np.concatenate([self._states, np.zeros_like(self._states)])
        self._times[index], self._states[index] = instant.time_s, instant.parcels
        self._instants[index:] = [instant]

    def _thin(self) -> None:
        """Drop every other instant of the older half."""
        half = len(self._instants) // 2
        rows: NDArray[np.int64] = np.append(np.arange(0, half, 2), np.arange(half, len(self._instants)))
        self._instants = [self._instants[row] for row in rows.tolist()]
        self._times[: len(rows)], self._states[: len(rows)] = self._times[rows], self._states[rows]
