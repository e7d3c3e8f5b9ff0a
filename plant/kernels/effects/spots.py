"""Coverage of analogue sensors' round spots by parcels."""

from __future__ import annotations

from math import atan2, cos, pi, sin, sqrt
from typing import Final

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.footprint import box
from plant.kernels.common.select import parcel_view

NOTHING: Final = 2.0**-48
"""A share below this is rounding: a spot beside a corner has none of it covered."""


@kernel
def swept(h, p, q):
    """The angle at the centre over a line at the distance ``h``, from ``p`` to ``q`` along it: under half a turn."""
    return atan2(h * (q - p), h * h + p * q)


@kernel
def share(qx, qy, vertices, normal, offset, radius):
    """The share of a disc about a point of the footprint's axes that a convex footprint covers, in [0, 1].

    Exact, by Green's theorem: with the disc's centre an edge encloses a triangle as far as it lies in the disc, and
    sectors of it where it lies outside; the signed areas of all edges add up to what they have in common.
    """
    edges = offset.shape[0]
    least = 1e300
    for e in range(edges):
        least = min(least, offset[e] - normal[e, 0] * qx - normal[e, 1] * qy)
    if least >= radius:
        return 1.0
    if least <= -radius:
        return 0.0
    twice = 0.0  # the area in radii squared, two times
    for e in range(edges):
        nx, ny = normal[e, 0], normal[e, 1]
        after = e + 1 if e + 1 < edges else 0
        # in radii: how far inside the edge the centre is, and where the edge's ends are along it from there
        h = (offset[e] - nx * qx - ny * qy) / radius
        start = (nx * (vertices[e, 1] - qy) - ny * (vertices[e, 0] - qx)) / radius
        end = (nx * (vertices[after, 1] - qy) - ny * (vertices[after, 0] - qx)) / radius
        half = sqrt(max(0.0, 1.0 - h * h))
        first, last = min(max(start, -half), half), min(max(end, -half), half)
        twice += swept(h, start, first) + h * (last - first) + swept(h, last, end)
    covered = twice / (2.0 * pi)
    return 0.0 if covered < NOTHING else min(covered, 1.0)


@kernel
def cover_spots(positions, grid, parcels, which, sensors, reach, radius, level):
    """Add to the level ``(n, sensors)`` of every sensor the share of its spot under some of the parcels; at most 1.

    Args:
        positions: ``(n, 2)`` m, of the cells.
        grid: ``(rows, columns)`` index of each cell, or -1.
        parcels: ``plant.kernels.common.parcels.Parcels``.
        which: numbers of those that count.
        sensors: ``(s, 2)`` m, from a cell's centre; the same for every cell.
        reach: m, of the farthest sensor from its cell's centre.
        radius: of the spots, m.
        level: added to.
    """
    for n in range(which.shape[0]):
        parcel = parcel_view(parcels, which[n])
        y = parcel.y
        c, s = cos(y[at.THETA]), sin(y[at.THETA])
        rows_columns = box(parcel.vertices, y, parcel.par, grid, reach + radius)
        for row in range(rows_columns[0], rows_columns[1] + 1):
            for column in range(rows_columns[2], rows_columns[3] + 1):
                cell = grid[row, column]
                if cell >= 0:
                    for k in range(sensors.shape[0]):
                        dx, dy = (
                            positions[cell, 0] + sensors[k, 0] - y[0],
                            positions[cell, 1] + sensors[k, 1] - y[1],
                        )
                        covered = share(
                            c * dx + s * dy,
                            -s * dx + c * dy,
                            parcel.vertices,
                            parcel.normal,
                            parcel.offset,
                            radius,
                        )
                        level[cell, k] = min(level[cell, k] + covered, 1.0)
