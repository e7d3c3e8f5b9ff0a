"""Contact manifold of two bodies: one point, or two points where edges lie along each other."""

from __future__ import annotations

from math import cos, sin
from typing import Final

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.contact import layout as to
from plant.kernels.contact.polygons import gap, widest

ASIDE: Final = 1e-9
"""The nearest points are taken to be corners where they are farther apart than the edges are by this much, m."""


@kernel
def facing(shapes, i, pose, nx, ny):
    """The edge of a shape that looks most along a direction. Returns its two corners in the world, from ``pose``."""
    c, s = cos(pose[2]), sin(pose[2])
    bx, by = c * nx + s * ny, -s * nx + c * ny
    start, end = shapes.corner[i], shapes.corner[i + 1]
    best, most = start, -1e300
    for e in range(start, end):
        along = bx * shapes.normal[e, 0] + by * shapes.normal[e, 1]
        if along > most:
            best, most = e, along
    after = best + 1 if best + 1 < end else start
    ax, ay = shapes.vertices[best, 0], shapes.vertices[best, 1]
    ex, ey = shapes.vertices[after, 0], shapes.vertices[after, 1]
    return c * ax - s * ay, s * ax + c * ay, c * ex - s * ey, s * ex + c * ey


@kernel
def note(row, x, y, nx, ny, space):
    """Write a point."""
    row[to.PX], row[to.PY], row[to.NORMAL_X], row[to.NORMAL_Y], row[to.SPACE] = x, y, nx, ny, space


@kernel
def along_edge(shapes, i, j, pi, pj, nx, ny, flip, rows, count):
    """Points of the edge of ``j`` that faces an edge of ``i`` with normal ``(nx, ny)``, as far as they lie over it.

    ``flip`` is -1 where the normals written must be turned round. Returns how many rows are in use then.
    """
    ax, ay, bx, by = facing(shapes, i, pi, nx, ny)
    qx, qy, rx, ry = facing(shapes, j, pj, -nx, -ny)
    dx, dy = pj[0] - pi[0], pj[1] - pi[1]
    qx, qy, rx, ry = qx + dx, qy + dy, rx + dx, ry + dy
    # along the edge of i, from its first corner
    low, high = 0.0, nx * (by - ay) - ny * (bx - ax)
    first, last = nx * (qy - ay) - ny * (qx - ax), nx * (ry - ay) - ny * (rx - ax)
    if max(first, last) < low or min(first, last) > high:
        return count
    begin, length, previous = count, last - first, 0.0
    for end in (first, last):
        place = min(max(end, low), high)
        if count > begin and abs(place - previous) < ASIDE:
            continue
        share = (place - first) / length if length != 0.0 else 0.0
        x, y = qx + share * (rx - qx), qy + share * (ry - qy)
        note(rows[count], x + pi[0], y + pi[1], flip * nx, flip * ny, nx * (x - ax) + ny * (y - ay))
        previous = place
        count += 1
    return count


@kernel
def contact_points(shapes, i, j, pi, pj, rows, count):
    """Points at which ``j`` is nearest to ``i``: one or two rows. Returns how many are in use then."""
    first, nx, ny = widest(shapes, i, j, pi, pj, at.FORWARD)
    second, mx, my = widest(shapes, j, i, pj, pi, at.FORWARD)
    distance, ox, oy = gap(shapes, i, j, pi, pj)
    begin = count
    if distance <= max(first, second) + ASIDE:
        # an edge of either may be the one the other lies on: the first's, unless the second's is clearly farther out
        if second > first + ASIDE:
            count = along_edge(shapes, j, i, pj, pi, mx, my, at.BACKWARD, rows, count)
        else:
            count = along_edge(shapes, i, j, pi, pj, nx, ny, at.FORWARD, rows, count)
    if count == begin:
        # corner on corner: the one of j that lies farthest back along the normal
        ax, ay, bx, by = facing(shapes, j, pj, -ox, -oy)
        if ox * bx + oy * by < ox * ax + oy * ay:
            ax, ay = bx, by
        note(rows[count], ax + pj[0], ay + pj[1], ox, oy, distance)
        count += 1
    return count


@kernel
def build_rows(group, marks, mark, states, reach, rows, ends):
    """Write a row for every point of the pairs that are within ``reach``, m, ready for the problem of impulses.

    Args:
        group: ``plant.effects.parcel_contact.bodies.Group``.
        marks: ``(k,)`` of the pairs.
        mark: only pairs with this one, or ``EVERY``; and none of two bodies that stand.
        states: ``(b, 6)``.
        reach: m; a pair is left out if none of its points is as near.
        rows: ``(2 k, ROW_SIZE)``: written.
        ends: ``(2 k, 3)``: written.

    Returns:
        How many.
    """
    count = at.ZERO
    for p in range(group.pairs.shape[0]):
        i, j = group.pairs[p]
        if (mark != to.EVERY and marks[p] != mark) or group.inverse[i, 0] + group.inverse[j, 0] == 0.0:
            continue
        end = contact_points(group.shapes, i, j, states[i], states[j], rows, count)
        nearest = to.BEYOND
        for n in range(count, end):
            nearest = min(nearest, rows[n, to.SPACE])
        if nearest > reach:
            continue
        for n in range(count, end):
            row = rows[n]
            ends[n, 0], ends[n, 1], ends[n, to.PAIR] = i, j, p
            row[to.AX], row[to.AY] = row[to.PX] - states[i, 0], row[to.PY] - states[i, 1]
            row[to.BX], row[to.BY] = row[to.PX] - states[j, 0], row[to.PY] - states[j, 1]
            for k in range(to.WANTED, to.ROW_SIZE):
                row[k] = 0.0
        count = end
    return count


@kernel
def move_row(rows, ends, source, target):
    """Move a contact row from index ``source`` to ``target``, overwriting the row there."""
    if source != target:
        for k in range(to.ROW_SIZE):
            rows[target, k] = rows[source, k]
        for k in range(3):
            ends[target, k] = ends[source, k]
