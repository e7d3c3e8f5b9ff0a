"""Residuals of a protocol's field: distance from the previous tick and from the limit, in bounded memory."""

from __future__ import annotations

from array import array
from dataclasses import dataclass
from typing import ClassVar, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields

Floats = NDArray[np.float64]

_FIT_DECADES: Final = 2.5
"""Of the residual, above where it stops: the last of them are the slowest error's."""
_ROUNDING: Final = 4096 * np.finfo(np.float64).eps
"""Of the field's size: below that a residual is rounding."""
_ABOVE: Final = 5.0
"""Times the level at which a residual stops."""
_BLOCKS: Final = 20
_LEAST_POINTS, _FEW_POINTS = 6, 12
"""A fit needs; a fit of a fast decay has, though they reach back farther than the last decades."""
_TAIL_BLOCKS: Final = 8
_FALLS: Final = -20
"""Kendall's S of the tail's blocks, 28 at most: at or below this it falls, by chance in 3 of 1,000."""
_Z: Final = 1.959964
"""Of the normal distribution, 95 % within."""


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Rate:
    """Fitted convergence rate of a residual: factor from tick to tick.

    Attributes:
        factor: Below 1 the residual decays, above 1 it grows.
        low: Lower end of the 95 % confidence interval.
        high: Upper end of the 95 % confidence interval.
        from_tick: First tick of the fit.
        to_tick: Last tick of the fit.
        decades: Decades by which the residual fell in between; negative if it rose.
        floor: Level at which the residual stopped falling, above rounding; None if it had not stopped.
    """

    factor: float
    low: float
    high: float
    from_tick: int
    to_tick: int
    decades: float
    floor: float | None

    @property
    def ticks_per_decade(self) -> float | None:
        """Ticks in which the residual falls to a tenth; None if it does not fall."""
        return float(-np.log(10.0) / np.log(self.factor)) if 0.0 < self.factor < 1.0 else None


def fit_rate(tick: Floats, residual: Floats, scale: Floats) -> Rate | None:
    """The rate at which a residual dies out.

    The logarithm of the residual's root mean square over equal blocks of ticks is fitted by the median of the slopes
    between all pairs of blocks (Theil 1950), with Sen's interval (1968). The fit covers the last 2.5 decades above the
    level at which the residual stops falling, or the later half of what there is if that is less.

    Args:
        tick: ``(T,)``, rising.
        residual: ``(T,)``, at least 0; NaN where there is none.
        scale: ``(T,)``, size of the field so far: bounds what is rounding.

    Returns:
        The rate; None if there are too few ticks.
    """
    there = np.isfinite(residual) & (residual > _ROUNDING * scale)
    gone = np.flatnonzero(np.isfinite(residual) & ~there)
    # what comes after the residual was rounding for the first time is rounding too, unless it came back for good
    end = int(gone[0]) if len(gone) and np.mean(there[gone[0] :]) < 0.5 else len(residual)
    rows = np.flatnonzero(there[:end])
    if len(rows) < _LEAST_POINTS:
        return None
    ticks, log = tick[rows].astype(np.float64), np.log10(residual[rows])
    level = _level(log)
    if level is not None:
        above = np.flatnonzero(log > level + np.log10(_ABOVE))
        if len(above) < _LEAST_POINTS:
            return None
        ticks, log = ticks[: above[-1] + 1], log[: above[-1] + 1]
    first = _first(log)
    ticks, log = ticks[first:], log[first:]
    if len(ticks) < _LEAST_POINTS:
        return None
    slope, low, high = _slope(*_blocks(ticks, log))
    return Rate(
        factor=float(10.0**slope),
        low=float(10.0**low),
        high=float(10.0**high),
        from_tick=int(ticks[0]),
        to_tick=int(ticks[-1]),
        decades=float(-slope * (ticks[-1] - ticks[0])),
        floor=None if level is None else 10.0**level,
    )


def _level(log: Floats) -> float | None:
    """The logarithm at which a residual stops: that of its last quarter if that no longer falls; None if it falls."""
    tail = log[-(len(log) // 4) :]
    if len(tail) < _TAIL_BLOCKS:
        return None
    blocks = np.array([np.median(part) for part in np.array_split(tail, _TAIL_BLOCKS)])
    rises = np.sign(blocks[None, :] - blocks[:, None])[np.triu_indices(_TAIL_BLOCKS, 1)].sum()
    level = float(np.median(tail))
    # one that has not fallen by a decade on the whole is slow, or steady, rather than at its end
    return None if rises <= _FALLS or level > np.max(log[: len(log) // 4]) - 1.0 else level


def _first(log: Floats) -> int:
    """Find the start of the last decades, or the middle if the series spans no more."""
    far = np.flatnonzero(np.abs(log - np.median(log[-3:])) > _FIT_DECADES)
    first = int(far[-1]) + 1 if len(far) else len(log) // 2
    return max(min(first, len(log) - _FEW_POINTS), 0)


def _blocks(ticks: Floats, log: Floats) -> tuple[Floats, Floats]:
    """Mean tick and logarithm of the root mean square of equal blocks: so that what oscillates counts by its size."""
    number = min(_BLOCKS, len(ticks))
    size = len(ticks) // number
    ticks, log = ticks[-number * size :].reshape(number, size), log[-number * size :].reshape(number, size)
    top = log.max(axis=1)
    return ticks.mean(axis=1), top + 0.5 * np.log10(np.mean(100.0 ** (log - top[:, None]), axis=1))


def _slope(x: Floats, y: Floats) -> tuple[float, float, float]:
    """The median slope between pairs of points, and the ends of its interval of 95 %."""
    n = len(x)
    i, j = np.triu_indices(n, 1)
    slopes = np.sort((y[j] - y[i]) / (x[j] - x[i]))
    pairs = len(slopes)
    spread = _Z * np.sqrt(n * (n - 1) * (2 * n + 5) / 18)
    high = min(round((pairs + spread) / 2), pairs - 1)
    low = max(round((pairs - spread) / 2) - 1, 0)
    return float(np.median(slopes)), float(slopes[low]), float(slopes[high])


Bools = NDArray[np.bool_]

CHANGE, ERROR, DISAGREEMENT = "change", "error", "disagreement"
_ALIKE: Final = 1e-9
"""Within this much of the greatest, the cells' limits are one limit for all."""
_SPREAD: Final = 1.25
"""Ratio of the ticks of two snapshots."""


@final
class Residuals:
    """Residuals of a field over all ticks, two numbers a residual and tick.

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

    state_fields: ClassVar[StateFields] = StateFields(
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
    """Sampled fields of a run, dense at first and then ever sparser, so that memory doesn't grow with run length.

    Attributes:
        retained: Tick, how far the field had moved by then (the sum of its changes' root mean squares), and the field.
    """

    state_fields: ClassVar[StateFields] = StateFields("retained", "_next", "_moved", "_last")

    def __init__(self) -> None:
        self.retained: list[tuple[int, float, Floats]] = []
        self._next = 0.0
        self._moved = 0.0
        self._last: tuple[int, float, Floats] | None = None

    def take(self, tick: int, change: float, field: Floats, live: Bools) -> None:
        """Take the field of a tick, ``(n, d)``, which differs from the last by ``change``."""
        self._moved += change
        shown = field if live.all() else np.where(live[:, None], field, np.nan)
        self._last = (tick, self._moved, shown)
        if tick >= self._next:
            self.retained.append(self._last)
            self._next = max(tick + 1.0, tick * _SPREAD)

    def chosen(self, most: int) -> list[tuple[int, Floats]]:
        """At most so many, the first and the last among them, about as far apart as the field moved between them."""
        retained = list(self.retained)
        if self._last is not None and retained[-1][0] != self._last[0]:
            retained.append(self._last)
        if len(retained) <= most:
            return [(tick, field) for tick, _, field in retained]
        distance = np.array([moved for _, moved, _ in retained])
        places = [0, len(retained) - 1]
        for part in range(1, most - 1):
            wanted = distance[-1] * part / (most - 1) if distance[-1] < np.inf else 0.0
            free = [i for i in range(len(retained)) if i not in places]
            places.append(min(free, key=lambda i, wanted=wanted: abs(distance[i] - wanted)))
        return [(retained[i][0], retained[i][2]) for i in sorted(places)]


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
