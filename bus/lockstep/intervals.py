"""Membership of a run's cells: the interval of ticks in which each cell is live."""

from __future__ import annotations

from collections.abc import Iterable
from typing import final

import numpy as np

from bus.lattice import NO_TICK_LIMIT
from bus.partition import Index
from bus.wire.msgpack_codec import Mask


@final
class Membership:
    """Interval of live ticks of each cell, from a first tick to an end tick.

    Args:
        cells: Number of cells.

    Attributes:
        first_tick: ``(n,)`` int64, first live tick; 0 except for cells that rejoined.
        end_tick: ``(n,)`` int64, first tick in which the cell is dead.
        unchanged: Whether no cell ever died: masks of live cells can be skipped.
    """

    def __init__(self, cells: int) -> None:
        self.first_tick: Index = np.zeros(cells, dtype=np.int64)
        self.end_tick: Index = np.full(cells, NO_TICK_LIMIT, dtype=np.int64)
        self._planned: Index = self.end_tick.copy()
        self.unchanged = True

    def schedule_death(self, cells: Iterable[int], tick: int) -> None:
        """Schedule the permanent death of ``cells`` (indices) at ``tick``; a rejoin does not cancel it."""
        index = np.fromiter(cells, dtype=np.int64)
        self._planned[index] = np.minimum(self._planned[index], tick)
        self.mark_dead(index.tolist(), tick)

    def mark_dead(self, cells: Iterable[int], tick: int) -> None:
        """Mark ``cells`` (indices) as dead from ``tick`` on; an earlier end tick is retained."""
        index = np.fromiter(cells, dtype=np.int64)
        self.end_tick[index] = np.minimum(self.end_tick[index], tick)
        self.unchanged = False

    def admit(self, cells: Iterable[int], tick: int) -> None:
        """Readmit dead ``cells`` (indices) from ``tick`` on, until their scheduled death."""
        index = np.fromiter(cells, dtype=np.int64)
        self.first_tick[index] = tick
        self.end_tick[index] = self._planned[index]

    def live(self, tick: int) -> Mask:
        """Return the mask of cells that are live in ``tick``, ``(n,)``."""
        return (self.first_tick <= tick) & (tick < self.end_tick)

    def end_by_group(self, groups: Iterable[Index]) -> list[int]:
        """Return the end tick of each group of cells: the first tick in which all its cells are dead."""
        return [int(self.end_tick[cells].max()) for cells in groups]

    def start_by_group(self, groups: Iterable[Index]) -> list[int]:
        """Return the first tick of each group.

        Only cells with the group's latest end tick count; of these, the earliest first tick.
        """
        return [
            int(self.first_tick[cells][self.end_tick[cells] == self.end_tick[cells].max()].min())
            for cells in groups
        ]
