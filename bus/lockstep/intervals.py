"""From when on and until when each cell of a run takes part."""

from __future__ import annotations

from collections.abc import Iterable
from typing import final

import numpy as np

from bus.lattice import NO_TICK_LIMIT
from bus.partition import Index
from bus.wire.msgpack_codec import Mask


@final
class Membership:
    """For each cell, the ticks in which it takes part: from one on, until another.

    Args:
        cells: How many there are.

    Attributes:
        since: ``(n,)`` int64, the tick from which it takes part; 0 but for those that came back.
        until: ``(n,)`` int64, the tick from which it is gone.
        all: Whether no cell was ever retired: nobody need look.
    """

    def __init__(self, cells: int) -> None:
        self.first_tick: Index = np.zeros(cells, dtype=np.int64)
        self.end_tick: Index = np.full(cells, NO_TICK_LIMIT, dtype=np.int64)
        self._planned: Index = self.end_tick.copy()
        self.unchanged = True

    def schedule_death(self, cells: Iterable[int], tick: int) -> None:
        """``cells`` (indices) will be gone from ``tick`` on, whatever happens to them before."""
        index = np.fromiter(cells, dtype=np.int64)
        self._planned[index] = np.minimum(self._planned[index], tick)
        self.mark_dead(index.tolist(), tick)

    def mark_dead(self, cells: Iterable[int], tick: int) -> None:
        """``cells`` (indices) are gone from ``tick`` on, or earlier if they were to go earlier."""
        index = np.fromiter(cells, dtype=np.int64)
        self.end_tick[index] = np.minimum(self.end_tick[index], tick)
        self.unchanged = False

    def admit(self, cells: Iterable[int], tick: int) -> None:
        """``cells`` (indices), which are gone, take part again from ``tick`` on."""
        index = np.fromiter(cells, dtype=np.int64)
        self.first_tick[index] = tick
        self.end_tick[index] = self._planned[index]

    def live(self, tick: int) -> Mask:
        """``(n,)``: the cells that take part in ``tick``."""
        return (self.first_tick <= tick) & (tick < self.end_tick)

    def end_by_group(self, groups: Iterable[Index]) -> list[int]:
        """For each group of cells, the tick from which all of them are gone."""
        return [int(self.end_tick[cells].max()) for cells in groups]

    def start_by_group(self, groups: Iterable[Index]) -> list[int]:
        """For each group, the tick from which the first takes part of those that stay longest."""
        return [
            int(self.first_tick[cells][self.end_tick[cells] == self.end_tick[cells].max()].min())
            for cells in groups
        ]
