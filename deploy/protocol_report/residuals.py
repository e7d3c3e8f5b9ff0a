"""How far a protocol's field is from where it was and from where it goes, tick by tick, in bounded memory."""

from __future__ import annotations

from array import array
from typing import ClassVar, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.memory import Remembers

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

CHANGE, ERROR, DISAGREEMENT = "change", "error", "disagreement"
_ALIKE: Final = 1e-9
"""Within this much of the greatest, the cells' limits are one limit for all."""
_SPREAD: Final = 1.25
"""Ratio of the ticks of two snapshots."""


@final
class Residuals:
    """Takes the field of every tick and keeps what is left of it: two numbers a residual.

    ``change`` is to the tick before that was taken, ``error`` to the limit, ``disagreement`` to the mean of the cells,
    kept where the limit is the same for all. Cells that are not there, and numbers that are none, are left out.

    Args:
        limit: ``(n, d)``, where theory says that the field goes; None where it does not say.

    Attributes:
        tick: Of every field that was taken.
        rms: By residual its root mean square in every tick; NaN where there is none.
        most: By residual its greatest number in every tick.
        scale: The greatest finite number of the field so far, in every tick.
        moved: The last tick in which any number was another than in the one before; 0 if none ever was.
    """

    remembers: ClassVar[Remembers] = Remembers(
        "_limit", "tick", "rms", "most", "scale", "_greatest", "moved", "_last"
    )

    def __init__(self, limit: Floats | None) -> None:
        self._limit = limit
        names = [CHANGE]
        if limit is not None:
            names.append(ERROR)
            if len(limit) and np.ptp(limit, axis=0).max(initial=0.0) <= _ALIKE * abs(limit).max(initial=0.0):
                names.append(DISAGREEMENT)
        self.tick = array("q")
        self.rms = {name: array("d") for name in names}
        self.most = {name: array("d") for name in names}
        self.scale = array("d")
        self._greatest = 0.0
        self.moved = 0
        self._last: Floats | None = None

    def take(self, tick: int, field: Floats, live: Bools) -> float:
        """Take the field of a tick.

        Args:
            tick: Later than the last.
            field: ``(n, d)``; not changed afterwards.
            live: ``(n,)``: whose rows count.

        Returns:
            The root mean square of what changed; 0 in the first tick.
        """
        field = field if live.all() else np.where(live[:, None], field, np.nan)
        finite = np.abs(field[np.isfinite(field)])
        self._greatest = max(self._greatest, float(finite.max(initial=0.0)))
        self.scale.append(self._greatest)
        self.tick.append(tick)
        changed = np.full(1, np.nan) if self._last is None else _difference(field, self._last)
        change, most = self._note(CHANGE, changed)
        if most > 0.0:
            self.moved = tick
        if self._limit is not None:
            self._note(ERROR, _difference(field, self._limit))
        if DISAGREEMENT in self.rms:
            self._note(DISAGREEMENT, field - _mean(field))
        self._last = field
        return change if change > 0.0 else 0.0

    def _note(self, name: str, difference: Floats) -> tuple[float, float]:
        rms, most = _size(difference)
        self.rms[name].append(rms)
        self.most[name].append(most)
        return rms, most


@final
class Snapshots:
    """A few fields of a run, close together at first and ever farther apart: a run's length does not matter.

    Attributes:
        kept: Tick, how far the field had moved by then (the sum of its changes' root mean squares), and the field.
    """

    remembers: ClassVar[Remembers] = Remembers("kept", "_next", "_moved", "_last")

    def __init__(self) -> None:
        self.kept: list[tuple[int, float, Floats]] = []
        self._next = 0.0
        self._moved = 0.0
        self._last: tuple[int, float, Floats] | None = None

    def take(self, tick: int, change: float, field: Floats, live: Bools) -> None:
        """Take the field of a tick, ``(n, d)``, which differs from the last by ``change``."""
        self._moved += change
        shown = field if live.all() else np.where(live[:, None], field, np.nan)
        self._last = (tick, self._moved, shown)
        if tick >= self._next:
            self.kept.append(self._last)
            self._next = max(tick + 1.0, tick * _SPREAD)

    def chosen(self, most: int) -> list[tuple[int, Floats]]:
        """At most so many, the first and the last among them, about as far apart as the field moved between them."""
        kept = list(self.kept)
        if self._last is not None and kept[-1][0] != self._last[0]:
            kept.append(self._last)
        if len(kept) <= most:
            return [(tick, field) for tick, _, field in kept]
        way = np.array([moved for _, moved, _ in kept])
        places = [0, len(kept) - 1]
        for part in range(1, most - 1):
            wanted = way[-1] * part / (most - 1) if way[-1] < np.inf else 0.0
            free = [i for i in range(len(kept)) if i not in places]
            places.append(min(free, key=lambda i, wanted=wanted: abs(way[i] - wanted)))
        return [(kept[i][0], kept[i][2]) for i in sorted(places)]


def _difference(one: Floats, other: Floats) -> Floats:
    """Zero also where both are the same infinity: far and still far."""
    with np.errstate(invalid="ignore", over="ignore"):
        return np.where(one == other, 0.0, one - other)


def _mean(field: Floats) -> Floats:
    finite = np.isfinite(field)
    number = np.maximum(finite.sum(axis=0), 1)
    with np.errstate(over="ignore"):
        return np.where(finite, field, 0.0).sum(axis=0) / number


def _size(difference: Floats) -> tuple[float, float]:
    """Root mean square and greatest of the numbers there are; NaN of none."""
    numbers = np.abs(difference[np.isfinite(difference)])
    if not len(numbers):
        return np.nan, np.nan
    most = float(numbers.max())
    if most == 0.0:
        return 0.0, 0.0
    part = numbers / most  # a field that grows without bound has squares beyond the largest number
    return most * float(np.sqrt(np.mean(part * part))), most
