"""Health of the cells over time, from the records of faults and losses."""

from __future__ import annotations

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

    Args:
        cells: ``(row, column)`` of every cell.

    Attributes:
        count: Number of records taken.
    """

    def __init__(self, cells: Sequence[Sequence[int]]) -> None:
        self._index = {(int(row), int(column)): i for i, (row, column) in enumerate(cells)}
        self._lost: set[int] = set()
        self._active: dict[int, tuple[str, list[int]]] = {}
        self._times: list[float] = [-np.inf]
        self._health: list[NDArray[np.uint8]] = [np.full(len(cells), ALIVE, dtype=np.uint8)]
        self._faults: list[dict[int, tuple[str, list[int]]]] = [{}]
        self.count = 0

    def add(self, records: Iterable[Mapping[str, Any]]) -> None:
        """Take further records, in the order of time."""
        changed_s: float | None = None
        for record in records:
            time_s = float(record["time_s"])
            if changed_s is not None and time_s > changed_s:
                self._keep(changed_s)
            self._take(record)
            self.count += 1
            changed_s = time_s
        if changed_s is not None:
            self._keep(changed_s)

    def health(self, time_s: float) -> NDArray[np.uint8]:
        """Return the health of every cell at a time, ``(n,)``."""
        return self._health[self._at(time_s)]

    def active(self, time_s: float) -> Mapping[int, tuple[str, list[int]]]:
        """Return the active faults at a time: kind and indices of the cells, by number."""
        return self._faults[self._at(time_s)]

    def active_at(self, time_s: float, cell: int) -> list[tuple[int, str]]:
        """Return number and kind of the active faults of one cell."""
        return [(number, kind) for number, (kind, cells) in self.active(time_s).items() if cell in cells]

    def _at(self, time_s: float) -> int:
        return int(np.searchsorted(self._times, time_s + 1e-12, side="right")) - 1

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

    def _keep(self, time_s: float) -> None:
        health = np.full(len(self._index), ALIVE, dtype=np.uint8)
        for kind, cells in self._active.values():
            health[cells] = np.maximum(health[cells], DEAD if kind in _DEADLY else FAULTY)
        health[sorted(self._lost)] = DEAD
        if time_s <= self._times[-1]:
            self._health[-1], self._faults[-1] = health, dict(self._active)
            return
        self._times.append(time_s)
        self._health.append(health)
        self._faults.append(dict(self._active))
