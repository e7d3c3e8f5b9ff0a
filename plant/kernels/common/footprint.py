"""Footprint coverage at one instant: cells under a parcel, presence bits."""

from __future__ import annotations

from math import cos, sin

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.select import parcel_view

EDGE_SLACK = 4.0
"""A sensor this many roundings outside the edge is covered: that of a parcel at rest on it must not flicker."""


@kernel
def box(vertices, y, par, grid, margin):
    """Rows and columns that the footprint's bounding box, widened by ``margin``, can touch."""
    c, s = cos(y[at.THETA]), sin(y[at.THETA])
    low_x = high_x = low_y = high_y = 0.0
    for v in range(vertices.shape[0]):
        vx, vy = c * vertices[v, 0] - s * vertices[v, 1], s * vertices[v, 0] + c * vertices[v, 1]
        low_x, high_x = min(low_x, vx), max(high_x, vx)
        low_y, high_y = min(low_y, vy), max(high_y, vy)
    pitch = par[at.PITCH]
    left, below = y[0] - par[at.ORIGIN_X] - margin, y[1] - par[at.ORIGIN_Y] - margin
    first_column = int(max(0.0, (left + low_x) / pitch))
    last_column = int(max(-1.0, min(grid.shape[1] - 1.0, (left + high_x + 2.0 * margin) / pitch)))
    first_row = int(max(0.0, (below + low_y) / pitch))
    last_row = int(max(-1.0, min(grid.shape[0] - 1.0, (below + high_y + 2.0 * margin) / pitch)))
    return first_row, last_row, first_column, last_column


@kernel
def mitre(normal):
    """How far from a corner, at most, the point lies that is a unit outside of both its edges."""
    most, last = 1.0, normal.shape[0] - 1
    for edge in range(normal.shape[0]):
        cosine = normal[edge, 0] * normal[last, 0] + normal[edge, 1] * normal[last, 1]
        most, last = max(most, (2.0 / (1.0 + cosine)) ** 0.5), edge
    return most


@kernel
def inside(px, py, normal, offset, y, c, s, slack):
    """Whether a point of the surface is under the footprint, the boundary and ``slack`` included."""
    dx, dy = px - y[0], py - y[1]
    qx, qy = c * dx + s * dy, -s * dx + c * dy
    for edge in range(offset.shape[0]):
        if offset[edge] - normal[edge, 0] * qx - normal[edge, 1] * qy < -slack:
            return False
    return True


@kernel
def cover(surface, parcels, which, sensors, reach, bits):
    """Set the presence bits ``(n, sensors)`` of every sensor under some of the parcels.

    Args:
        surface: ``plant.kernels.common.surface.Surface``.
        parcels: ``plant.kernels.common.parcels.Parcels``.
        which: numbers of those that count.
        sensors: ``(s, 2)`` m, from a cell's centre; the same for every cell.
        reach: m, of the farthest sensor from its cell's centre.
        bits: only ever set.
    """
    grid = surface.grid
    for n in range(which.shape[0]):
        parcel = parcel_view(parcels, which[n])
        y, slack = parcel.y, EDGE_SLACK * parcel.par[at.ON_SURFACE]
        c, s = cos(y[at.THETA]), sin(y[at.THETA])
        first_row, last_row, first_column, last_column = box(
            parcel.vertices, y, parcel.par, grid, reach + slack
        )
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                cell = grid[row, column]
                if cell >= 0:
                    for k in range(sensors.shape[0]):
                        px, py = surface.pos[cell, 0] + sensors[k, 0], surface.pos[cell, 1] + sensors[k, 1]
                        if inside(px, py, parcel.normal, parcel.offset, y, c, s, slack):
                            bits[cell, k] = True


@kernel
def any_rest_change(before, after, span, radius, resting, which, limit):
    """Whether some of the parcels ``which`` come to rest, or begin to move, with a step from one state to another.

    Args:
        before: ``(m, 6)``.
        after: ``(m, 6)``.
        span: s between the states.
        radius: ``(m,)`` farthest corner of each from its centre of mass, m.
        resting: ``(m,)`` bool: which have been at rest so far.
        which: ``(b,)`` their numbers.
        limit: m/s, of every corner; and its most gain in speed a second.
    """
    for n in range(which.shape[0]):
        i = which[n]
        still = True
        for axis in range(at.UX, at.OMEGA + 1):
            arm = radius[i] if axis == at.OMEGA else 1.0
            first, last = before[i, axis] * arm, after[i, axis] * arm
            # a number that is not finite is not small
            small = abs(first) < limit and abs(last) < limit and abs(last - first) < limit * span
            still = still and small
        if still != resting[i]:
            return True
    return False


@kernel
def may_go_on(stop, taken, steps, now):
    """Status before another step: whether somebody asks for the call's end, or too many steps led no farther.

    Args:
        stop: ``(1,)``: see ``plant.stop``.
        taken: steps of this call so far.
        steps: ``(2,)`` allowed: at once, and more for each second reached.
        now: s reached in this call.
    """
    if stop[0] != 0:
        return at.STOPPED
    return at.ENDLESS_STEPS if taken > steps[0] + steps[1] * now else at.MOVING


@kernel
def sampled_until(now, y, times, sampled, out):
    """Write ``y`` for the ``times`` up to ``now``, of which the first ``sampled`` are written. Returns how many are."""
    while sampled < times.shape[0] and times[sampled] <= now:
        for k in range(6):
            out[sampled, k] = y[k]
        sampled += 1
    return sampled


@kernel
def fill(y, times, sampled, out):
    """Write ``y``, where the motion ended, for all ``times`` after the first ``sampled``."""
    for i in range(sampled, times.shape[0]):
        for k in range(6):
            out[i, k] = y[k]
