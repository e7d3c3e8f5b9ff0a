"""Health of the cells over time, from the records of faults and losses."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

ALIVE, FAULTY, DEAD = 0, 1, 2
"""Values of a cell's health; a lost or removed cell counts as dead."""

_DEADLY: Final = frozenset(("crash", "remove", "add"))
"""Kinds of faults whose cells don't take part while the fault is active."""
_BACK: Final = "respawn"


@final
class FaultState:
    """Health of the cells, and active faults, at every time that records tell of.

    The state at one time is kept: a later one is reached from it, an earlier one from the beginning.

    Args:
        cells: ``(row, column)`` of every cell.
    """

    def __init__(self, cells: Sequence[Sequence[int]]) -> None:
        self._index = {(int(row), int(column)): i for i, (row, column) in enumerate(cells)}
        self._records: list[Mapping[str, Any]] = []
        self._times: list[float] = []
        self._taken = 0
        self._lost: set[int] = set()
        self._active: dict[int, tuple[str, list[int]]] = {}
        self._health: NDArray[np.uint8] | None = None

    def add(self, records: Iterable[Mapping[str, Any]]) -> None:
        """Take further records, in the order of time."""
        for record in records:
            self._records.append(record)
            self._times.append(max(float(record["time_s"]), self._times[-1] if self._times else -np.inf))

    def health(self, time_s: float) -> NDArray[np.uint8]:
        """Return the health of every cell at a time, ``(n,)``."""
        self._go_to(time_s)
        if self._health is None:
            health = np.full(len(self._index), ALIVE, dtype=np.uint8)
            for kind, cells in self._active.values():
                health[cells] = np.maximum(health[cells], DEAD if kind in _DEADLY else FAULTY)
            health[sorted(self._lost)] = DEAD
            self._health = health
        return self._health

    def active(self, time_s: float) -> Mapping[int, tuple[str, list[int]]]:
        """Return the active faults at a time: kind and indices of the cells, by number."""
        self._go_to(time_s)
        return dict(self._active)

    def active_at(self, time_s: float, cell: int) -> list[tuple[int, str]]:
        """Return number and kind of the active faults of one cell."""
        return [(number, kind) for number, (kind, cells) in self.active(time_s).items() if cell in cells]

    def _go_to(self, time_s: float) -> None:
        """Take the records up to a time into the state."""
        wanted = bisect_right(self._times, time_s + 1e-12)
        if wanted < self._taken:
            self._taken, self._health = 0, None
            self._lost.clear()
            self._active.clear()
        for record in self._records[self._taken : wanted]:
            self._take(record)
            self._health = None
        self._taken = wanted

    def _take(self, record: Mapping[str, Any]) -> None:
        kind, phase = str(record["kind"]), record.get("phase")
        named = record.get("cells") or ([record["cell"]] if record.get("cell") else [])
        cells = [
            self._index[place] for row, column in named if (place := (int(row), int(column))) in self._index
        ]
        if kind == _BACK:
            self._lost.difference_update(cells)
        elif phase is None:
            self._lost.update(cells)
        elif phase == "begins":
            self._active[int(record["number"])] = (kind, cells)
        elif phase == "ends":
            self._active.pop(int(record["number"]), None)
