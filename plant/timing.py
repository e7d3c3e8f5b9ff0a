"""When, within a call of the plant, each cell acts and reads: for cells that do so at instants of their own."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from plant.errors import PlantError

Floats = NDArray[np.float64]


class Timing(NamedTuple):
    """Instants of the cells between ``now`` and ``until``, both in ns of simulated time.

    Attributes:
        acts_ns: ``(n,)`` in ``[now, until)``: when a cell's drive of this call takes effect; before, its last one goes
            on. -1: it acts from the start.
        reads_ns: ``(n,)`` in ``[now, until]``: when a cell reads sensors and encoders. -1: it doesn't in this call.
    """

    acts_ns: NDArray[np.int64]
    reads_ns: NDArray[np.int64]

    def check(self, cells: int, now_ns: int, until_ns: int) -> None:
        """Refuse instants that are not of this call.

        Args:
            cells: how many the array has.
            now_ns: when the call begins.
            until_ns: when it ends.

        Raises:
            PlantError: one isn't, or there are instants of another number of cells.
        """
        spans = (("acts_ns", now_ns, until_ns - 1), ("reads_ns", now_ns, until_ns))
        for (name, first, last), given in zip(spans, self, strict=True):
            if given.shape != (cells,):
                raise PlantError(f"{name} has shape {given.shape}: the array has {cells} cells")
            wrong = ((given < first) & (given != -1)) | (given > last)
            if wrong.any():
                cell = int(np.flatnonzero(wrong)[0])
                raise PlantError(f"{name}[{cell}] = {given[cell]}: must be -1 or in {first}..{last}")

    def acts_s(self, now_ns: int) -> Floats:
        """``(n,)`` s after ``now_ns`` when drives take effect; 0 at the start."""
        return np.maximum(self.acts_ns - now_ns, 0) * 1e-9

    def reads_s(self, now_ns: int, until_ns: int) -> Floats:
        """``(n,)`` s after ``now_ns`` when cells read; infinite for those that don't between the call's ends."""
        inside = (self.reads_ns > now_ns) & (self.reads_ns < until_ns)
        return np.where(inside, (self.reads_ns - now_ns) * 1e-9, np.inf)
