"""Cell clocks: step times under crystal errors and interrupt phases."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice

Ints = NDArray[np.int64]

BILLION: Final = 1_000_000_000
"""Parts in ppb; nanoseconds in a second."""
NOT_IN_WINDOW: Final = -1
"""Instead of an instant: there is none."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class CellClocks:
    """The clocks of n cells: when each steps, by its own crystal, in nanoseconds of simulated time.

    With P the nominal period and e the clock's error in ppb, the m-th instant of a cell, m = 0, 1, ..., is ::

        phase + floor(m P (10^9 + e) / 10^9)

    Window k is ``[k W, (k + 1) W)``; W is no longer than any cell's period, so that a cell has at most one instant in
    it. All is exact in integers to 10^9 s, and a function of these numbers alone, so that whoever has them (the plant,
    every shard) knows every cell's instants.

    Attributes:
        period_ns: Nominal control period P.
        window_ns: W: what one exchange between plant and cells serves.
        ppb: ``(n,)`` int64, by how much each clock's periods are longer than nominal, parts in 10^9.
        phase_ns: ``(n,)`` int64, each cell's first instant, >= 0.
    """

    period_ns: int
    window_ns: int
    ppb: Ints
    phase_ns: Ints

    def __len__(self) -> int:
        return len(self.ppb)

    def take(self, cells: Ints) -> CellClocks:
        """Select the clocks of ``cells``, in order."""
        return CellClocks(self.period_ns, self.window_ns, self.ppb[cells], self.phase_ns[cells])

    def instants(self, window: int) -> Ints:
        """``(n,)``: when each cell steps in a window; ``NOT_IN_WINDOW`` where it doesn't."""
        return self.due(window, self.count_before(window * self.window_ns))

    def due(self, window: int, count: Ints) -> Ints:
        """Return the instants in a window, given the number of earlier instants, ``count``, ``(n,)``."""
        at = self.instant(count)
        return np.where(at < (window + 1) * self.window_ns, at, NOT_IN_WINDOW)

    def instant(self, number: Ints) -> Ints:
        """``(n,)``: each cell's instant of this number, counted from 0."""
        nominal = number * self.period_ns
        # floor(nominal ppb / 10^9), in two parts: the product can exceed 64 bits
        whole = nominal // BILLION
        rest = nominal - whole * BILLION
        return self.phase_ns + nominal + whole * self.ppb + rest * self.ppb // BILLION

    def count_before(self, time_ns: int) -> Ints:
        """``(n,)``: how many instants each cell has before a time."""
        # the least m >= 0 with m P (10^9 + e) / 10^9 >= time - phase; its quotient by 10^9 + e in two parts, as above
        parts = self.ppb + BILLION
        whole, rest = np.divmod(time_ns - self.phase_ns, parts)
        true = whole * BILLION - -rest * BILLION // parts
        return np.maximum(-(-true // self.period_ns), 0)


@final
@dataclass(frozen=True, slots=True, eq=False)
class ArrayClocks:
    """The clocks of a whole array.

    Attributes:
        lattice: Cells of the array.
        clocks: Clocks of the cells, in the lattice's order.
    """

    lattice: Lattice
    clocks: CellClocks

    def of(self, row: Ints, column: Ints) -> CellClocks:
        """Return the clocks of the cells at these rows and columns, ``(n,)`` each; all must exist."""
        return self.clocks.take(self.lattice.find(row, column))

    def ppb(self, row: Ints, column: Ints) -> Ints:
        """Errors of the clocks at these rows and columns, of any shape; 0 where there is no cell."""
        cell = self.lattice.find(row, column)
        return np.where(cell >= 0, self.clocks.ppb[cell], 0)
