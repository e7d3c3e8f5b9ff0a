"""Convex polygons: orientation, area, centroid, moment of inertia, edges, overlap."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Pairs = NDArray[np.intp]


def close_boxes(low: Floats, high: Floats) -> Pairs:
    """Pairs of boxes, sides along the axes, that overlap.

    The plane is cut into strips twice as wide as the mean box, along the axis along which boxes lie farthest apart. In
    each, boxes are sorted and compared with those that begin before they end: time grows as the number of boxes and of
    those that overlap along the strip.

    Args:
        low: ``(m, 2)`` least coordinates.
        high: ``(m, 2)`` greatest coordinates.

    Returns:
        ``(k, 2)`` indices, the lesser first, in lexical order.
    """
    count = len(low)
    if count < 2:
        return np.zeros((0, 2), dtype=np.intp)
    along = int(np.argmax(np.ptp(low, axis=0)))
    box, strip = _strips(low[:, 1 - along], high[:, 1 - along])
    # places among all begins in place of coordinates: whole numbers, which strips don't round
    begins = np.sort(low[:, along])
    begin = strip * (count + 1) + _places(begins, low[box, along])
    order = np.argsort(begin, kind="stable")
    box, strip, begin = box[order], strip[order], begin[order]
    end = strip * (count + 1) + _places(begins, high[box, along])
    later = np.maximum(_places(begin, end) - np.arange(len(box)) - 1, 0)
    first = np.repeat(np.arange(len(box)), later)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(later) - later, later)
    pairs = np.stack([box[first], box[second]], axis=1)
    pairs.sort(axis=1)
    i, j = pairs.T
    pairs = pairs[np.all((low[i] < high[j]) & (low[j] < high[i]), axis=1)]
    # those in two strips are found twice
    return np.stack(np.divmod(np.unique(pairs[:, 0] * count + pairs[:, 1]), count), axis=1)


def _places(ascending: NDArray[Any], values: NDArray[Any]) -> Pairs:
    """How many of the ascending numbers are less than each value."""
    return np.asarray(np.searchsorted(ascending, values, side="left"), dtype=np.intp)


def _strips(low: Floats, high: Floats) -> tuple[Pairs, Pairs]:
    """Which box lies in which strip, box by box, each strip as often as a box reaches into it; both ``(k,)``."""
    origin, width = low.min(), 2.0 * float(np.mean(high - low))
    if width <= 0.0 or not np.isfinite(width):
        return np.arange(len(low)), np.zeros(len(low), dtype=np.intp)
    most = len(low) - 1.0
    first = np.minimum((low - origin) // width, most).astype(np.intp)
    last = np.minimum((high - origin) // width, most).astype(np.intp)
    many = last - first + 1
    box = np.repeat(np.arange(len(low)), many)
    return box, first[box] + np.arange(len(box)) - np.repeat(np.cumsum(many) - many, many)


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


ADJACENT = 1e-9
"""Polygons that overlap by no more than this share of the lesser one's extent are beside each other."""
Vertices = Sequence[tuple[float, float]]


class PolygonError(ValueError):
    """The corners are not those of a convex polygon; the text says which rule fails where."""


def rectangle(length_m: float, width_m: float) -> tuple[tuple[float, float], ...]:
    """Corners of a rectangle about its centre, counter-clockwise, m."""
    a, b = length_m / 2.0, width_m / 2.0
    return ((-a, -b), (a, -b), (a, b), (-a, b))


def signed_area(vertices: Vertices) -> float:
    """Area in m², positive for counter-clockwise corners."""
    v = np.asarray(vertices, dtype=np.float64)
    w = np.roll(v, -1, axis=0)
    return float(np.sum(v[:, 0] * w[:, 1] - w[:, 0] * v[:, 1])) / 2.0


def check_convex(vertices: Vertices) -> None:
    """Refuse corners that are not those of a strictly convex polygon.

    Raises:
        PolygonError: fewer than three corners, no area, or a corner that is not convex.
    """
    if len(vertices) < 3:
        raise PolygonError(f"a polygon has at least 3 corners, not {len(vertices)}")
    v = np.asarray(vertices, dtype=np.float64)
    edge = np.roll(v, -1, axis=0) - v
    length = np.hypot(edge[:, 0], edge[:, 1])
    if not np.all(length > 0.0):
        raise PolygonError(f"corner {int(np.argmin(length))} is given twice")
    incoming = np.roll(edge, 1, axis=0)
    sine = (incoming[:, 0] * edge[:, 1] - incoming[:, 1] * edge[:, 0]) / (np.roll(length, 1) * length)
    if signed_area(vertices) < 0.0:
        sine = -sine
    worst = int(np.argmin(sine))
    if sine[worst] <= 1e-9:
        raise PolygonError(f"corner {worst} is not convex")
    turn = np.arctan2(sine, np.sum(incoming * edge, axis=1) / (np.roll(length, 1) * length))
    if abs(float(np.sum(turn)) - 2.0 * np.pi) > 1e-6:
        raise PolygonError("the corners go round more than once")


def counter_clockwise(vertices: Vertices) -> NDArray[np.float64]:
    """The corners as an ``(m, 2)`` array, counter-clockwise."""
    v = np.array(vertices, dtype=np.float64)
    return v if signed_area(vertices) > 0.0 else v[::-1].copy()


def centroid(vertices: Vertices) -> tuple[float, float]:
    """Centroid of the enclosed area, m."""
    v = counter_clockwise(vertices)
    origin = v[0]
    p = v - origin
    q = np.roll(p, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    mean = (cross @ (p + q)) / (3.0 * float(np.sum(cross)))
    return float(mean[0] + origin[0]), float(mean[1] + origin[1])


def polar_moment_per_mass(vertices: Vertices) -> float:
    """Moment of inertia of a uniform plate about its centroid, per kilogram, m²."""
    p = counter_clockwise(vertices) - np.array(centroid(vertices))
    q = np.roll(p, -1, axis=0)
    cross = p[:, 0] * q[:, 1] - q[:, 0] * p[:, 1]
    second = np.sum(p * p + p * q + q * q, axis=1)
    return float(cross @ second) / (6.0 * float(np.sum(cross)))


def edges(vertices: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Outward unit normals ``(m, 2)`` and offsets ``(m,)`` of a counter-clockwise polygon.

    A point ``q`` lies inside where ``offset - normal . q >= 0`` for every edge.
    """
    edge = np.roll(vertices, -1, axis=0) - vertices
    length = np.hypot(edge[:, 0], edge[:, 1])
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / length[:, None]
    return normal, np.sum(normal * vertices, axis=1)


def placed(footprint: NDArray[np.float64], pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Corners ``(m, 2)`` of a footprint about its centre of mass at the pose x, y, theta, ..."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return footprint @ np.array([[c, s], [-s, c]]) + pose[:2]


def corner_displacement_m(states: Floats, others: Floats, footprint: Floats) -> Floats:
    """Largest displacement of a parcel's corners between two poses, at each instant, ``(T,)`` m.

    Args:
        states: ``(T, 3)`` or wider: x, y, theta, ...; NaN gives NaN.
        others: Poses at the same instants, likewise.
        footprint: ``(v, 2)`` corners about the centre of mass, in the parcel's axes, m.
    """
    apart = states[:, :2] - others[:, :2]
    # the difference of two rotations, without cancellation: 2 sin(half the angle) across the mean direction
    chord = 2.0 * np.sin(0.5 * (states[:, 2] - others[:, 2]))
    mean = 0.5 * (states[:, 2] + others[:, 2])
    c, s = np.cos(mean)[:, None], np.sin(mean)[:, None]
    x = apart[:, :1] + chord[:, None] * (-s * footprint[:, 0] - c * footprint[:, 1])
    y = apart[:, 1:] + chord[:, None] * (c * footprint[:, 0] - s * footprint[:, 1])
    return np.hypot(x, y).max(axis=1)


def overlap(a: NDArray[np.float64], b: NDArray[np.float64]) -> tuple[float, NDArray[np.float64]] | None:
    """Depth in m and place ``(2,)`` in m of the overlap of two convex polygons, or None.

    Both are ``(m, 2)``, counter-clockwise. Separating axes: the depth is the least penetration over all edge
    normals, the place the middle of the corners of either that lie deepest in the other. Polygons that overlap by no
    more than ``ADJACENT`` of the lesser one's extent only touch: places are decimals, and rounded.
    """
    least, place = np.inf, np.zeros(2)
    touching = -ADJACENT * min(float(np.ptp(a, axis=0).max()), float(np.ptp(b, axis=0).max()))
    for first, second in ((a, b), (b, a)):
        normal, offset = edges(first)
        gap = second @ normal.T - offset
        inside = gap.min(axis=0)
        edge = int(np.argmax(inside))
        if inside[edge] >= touching:
            return None
        if -inside[edge] < least:
            least = -float(inside[edge])
            deepest = gap[:, edge] <= inside[edge] + 1e-12
            place = second[deepest].mean(axis=0)
    return least, place
