"""How fast a residual dies out: a factor a tick, fitted so that start, noise and rounding do not matter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

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
    """By which factor a residual shrinks from tick to tick.

    Attributes:
        factor: Below 1 it dies out, above 1 it grows.
        low: Of the interval of 95 % about it.
        high: Likewise.
        from_tick: First tick of the fit.
        to_tick: Its last.
        decades: By which the residual fell in between; negative if it rose.
        floor: Where the residual stopped falling, above rounding; None where it had not stopped.
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


def fitted(tick: Floats, residual: Floats, scale: Floats) -> Rate | None:
    """The rate at which a residual dies out.

    The logarithm of the residual's root mean square over equal blocks of ticks is fitted by the median of the slopes
    between all pairs of blocks (Theil 1950), with Sen's interval (1968). The fit covers the last 2.5 decades above the
    level at which the residual stops falling, or the later half of what there is if that is less.

    Args:
        tick: ``(T,)``, rising.
        residual: ``(T,)``, at least 0; NaN where there is none.
        scale: ``(T,)``, size of the field so far: tells what is rounding.

    Returns:
        The rate; None if there are too few ticks to tell.
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
    """Where the last decades begin; the middle if there are no more than those."""
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
