"""Time series of the quantity that colours cells, evaluated some instants at a time."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, final

import numpy as np

from deploy.view.forces import WheelForces
from deploy.view.quantities import QUANTITIES, REGISTER, quantity_of
from deploy.view.series import Series, register_series

if TYPE_CHECKING:
    from collections.abc import Sequence

    from deploy.view.source import Floats, RunSource

INSTANTS: Final = 128
"""Most instants of a line: loads of many parcels take some milliseconds each."""


@final
class QuantitySeries:
    """Values of a quantity of every cell over time; instants far apart come first, and others fill the gaps.

    Args:
        source: The run.
    """

    def __init__(self, source: RunSource) -> None:
        self._source = source
        self._known = (*QUANTITIES, *WheelForces(source, rest=0.0).quantities)
        self._subject: tuple[str, int] = ("", -1)
        self._values: dict[int, Floats] = {}
        self._categories: Sequence[str] = ()

    @property
    def count(self) -> int:
        """Number of instants that are evaluated."""
        return len(self._values)

    def advance(self, name: str, budget_s: float) -> None:
        """Evaluate a quantity at further instants.

        Args:
            name: Identifier of the quantity; nothing is evaluated for a register, whose values are there.
            budget_s: Wall time after which no instant is begun, s.
        """
        if (name, self._source.revision) != self._subject:
            self._subject, self._values, self._categories = (name, self._source.revision), {}, ()
        if name.startswith(REGISTER):
            return
        quantity, until_s = quantity_of(name, self._known), time.perf_counter() + budget_s
        for index in self._missing():
            values = quantity.values(self._source, index, self._source.at(index))
            # kinds of faults have other numbers whenever others are active
            self._values[index] = np.minimum(values.numbers, 1.0) if name == "fault" else values.numbers
            self._categories = ("none", "active") if name == "fault" else values.categories
            if time.perf_counter() >= until_s:
                return

    def _missing(self) -> list[int]:
        """Return the instants that are not evaluated yet, by how much they divide the time."""
        count = len(self._source.times_s)
        step = 1
        while count > step * INSTANTS:
            step *= 2
        rows = [row for row in range(0, count, step) if row not in self._values]
        return sorted(rows, key=lambda row: (-(row & -row) if row else -count, row))

    def series(self, name: str, cell: int) -> Series:
        """Return what is known of a quantity of a cell; see `advance`."""
        if name.startswith(REGISTER):
            return register_series(self._source, cell, name.removeprefix(REGISTER))
        quantity, (row, column) = quantity_of(name, self._known), self._source.header["cells"][cell]
        rows = sorted(self._values)
        numbers = np.array([self._values[index][cell] for index in rows], dtype=np.float64)
        title = f"{quantity.label} of cell {row},{column}"
        if self._categories:
            title += f" ({', '.join(f'{k} {one}' for k, one in enumerate(self._categories))})"
        return Series(title, quantity.unit, (quantity.label,), self._source.times_s[rows], numbers[:, None])
