"""From when on and until when each cell of a run takes part."""

from __future__ import annotations

from collections.abc import Iterable
from typing import final

import numpy as np

from bus.lattice import NEVER
from bus.partition import Index
from bus.wire.msgpack_codec import Mask


@final
class Lives:
    """For each cell, the ticks in which it takes part: from one on, until another.

    Args:
        cells: How many there are.

    Attributes:
        since: ``(n,)`` int64, the tick from which it takes part; 0 but for those that came back.
        until: ``(n,)`` int64, the tick from which it is gone.
        all: Whether no cell was ever retired: nobody need look.
    """

    def __init__(self, cells: int) -> None:
        self.since: Index = np.zeros(cells, dtype=np.int64)
        self.until: Index = np.full(cells, NEVER, dtype=np.int64)
        self._planned: Index = self.until.copy()
        self.all = True

    def plan(self, cells: Iterable[int], tick: int) -> None:
        """``cells`` (indices) will be gone from ``tick`` on, whatever happens to them before."""
        index = np.fromiter(cells, dtype=np.int64)
        self._planned[index] = np.minimum(self._planned[index], tick)
        self.retire(index.tolist(), tick)

    def retire(self, cells: Iterable[int], tick: int) -> None:
        """``cells`` (indices) are gone from ``tick`` on, or earlier if they were to go earlier."""
        index = np.fromiter(cells, dtype=np.int64)
        self.until[index] = np.minimum(self.until[index], tick)
        self.all = False

    def admit(self, cells: Iterable[int], tick: int) -> None:
        """``cells`` (indices), which are gone, take part again from ``tick`` on."""
        index = np.fromiter(cells, dtype=np.int64)
        self.since[index] = tick
        self.until[index] = self._planned[index]

    def live(self, tick: int) -> Mask:
        """``(n,)``: the cells that take part in ``tick``."""
        return (self.since <= tick) & (tick < self.until)

    def last(self, groups: Iterable[Index]) -> list[int]:
        """For each group of cells, the tick from which all of them are gone."""
        return [int(self.until[cells].max()) for cells in groups]

    def first(self, groups: Iterable[Index]) -> list[int]:
        """For each group, the tick from which the first takes part of those that stay longest."""
        return [
            int(self.since[cells][self.until[cells] == self.until[cells].max()].min()) for cells in groups
        ]
