"""Until when each cell of a run takes part."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Final, final

import numpy as np

from bus.codec import Mask
from bus.partition import Index

NEVER: Final = int(np.iinfo(np.int64).max)
"""The tick from which a live cell is gone."""


@final
class Lives:
    """For each cell, the tick from which it is gone.

    Args:
        cells: How many there are.

    Attributes:
        until: ``(n,)`` int64.
        all: Whether no cell was ever retired: nobody need look.
    """

    def __init__(self, cells: int) -> None:
        self.until: Index = np.full(cells, NEVER, dtype=np.int64)
        self.all = True

    def retire(self, cells: Iterable[int], tick: int) -> None:
        """``cells`` (indices) are gone from ``tick`` on, or earlier if they were to go earlier."""
        index = np.fromiter(cells, dtype=np.int64)
        self.until[index] = np.minimum(self.until[index], tick)
        self.all = False

    def live(self, tick: int) -> Mask:
        """``(n,)``: the cells that take part in ``tick``."""
        return self.until > tick

    def last(self, groups: Iterable[Index]) -> list[int]:
        """For each group of cells, the tick from which all of them are gone."""
        return [int(self.until[cells].max()) for cells in groups]
