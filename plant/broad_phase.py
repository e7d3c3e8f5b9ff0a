"""Which of many bodies may meet: sort and sweep, so that those far apart cost next to nothing."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Pairs = NDArray[np.intp]


def close_boxes(low: Floats, high: Floats) -> Pairs:
    """Pairs of boxes, sides along the axes, that overlap.

    The boxes are sorted along the axis along which they lie farther apart, and each is compared with those that begin
    before it ends.

    Args:
        low: ``(m, d)`` least coordinates.
        high: ``(m, d)`` greatest coordinates.

    Returns:
        ``(k, 2)`` indices, the lesser first, in lexical order.
    """
    count = len(low)
    if count < 2:
        return np.zeros((0, 2), dtype=np.intp)
    axis = int(np.argmax(np.ptp(low, axis=0)))
    order = np.argsort(low[:, axis], kind="stable")
    begins = low[order, axis]
    ends = np.asarray(np.searchsorted(begins, high[order, axis], side="left"), dtype=np.intp)
    places = np.arange(count)
    later = np.maximum(ends - places - 1, 0)
    first = np.repeat(places, later)
    start = np.cumsum(later) - later
    second = first + 1 + np.arange(len(first)) - np.repeat(start, later)
    pairs = np.stack([order[first], order[second]], axis=1)
    pairs.sort(axis=1)
    i, j = pairs.T
    pairs = pairs[np.all((low[i] < high[j]) & (low[j] < high[i]), axis=1)]
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def close_pairs(centre: Floats, radius: Floats) -> Pairs:
    """Pairs of discs that overlap.

    Args:
        centre: ``(m, 2)`` m.
        radius: ``(m,)`` m.

    Returns:
        ``(k, 2)`` indices, the lesser first, in lexical order.
    """
    pairs = close_boxes(centre - radius[:, None], centre + radius[:, None])
    i, j = pairs.T
    gap = centre[i] - centre[j]
    return pairs[np.hypot(gap[:, 0], gap[:, 1]) < radius[i] + radius[j]]
