"""Distance and separation of two convex polygons.

Shapes are listed one after another in ``shapes.vertices``, about a point of their own; ``pose`` is that point and the
angle. Distances are measured from one shape's point to the other's, so that digits survive far from the origin. A
segment is a polygon of two corners, whose two edges face away from each other.
"""

from __future__ import annotations

from math import cos, hypot, sin
from typing import Final

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at

COINCIDENT: Final = 1e-12
"""Corners nearer than this, m, have no direction from one to the other: an edge's normal is taken."""
CLEAR: Final = 0
UNSURE: Final = 1
"""Whether two shapes can have met between two instants."""


@kernel
def widest(shapes, i, j, pi, pj, flip):
    """The edge of shape ``i`` that shape ``j`` lies farthest beyond.

    Returns (how far, negative where it reaches in; the edge's unit normal in the world, out of ``i``, or turned round
    where ``flip`` is -1).
    """
    c, s = cos(pi[2]), sin(pi[2])
    turn = pj[2] - pi[2]
    cr, sr = cos(turn), sin(turn)
    dx, dy = pj[0] - pi[0], pj[1] - pi[1]
    dx, dy = c * dx + s * dy, -s * dx + c * dy
    best, nx, ny = -1e300, 0.0, 0.0
    for e in range(shapes.corner[i], shapes.corner[i + 1]):
        ex, ey = shapes.normal[e, 0], shapes.normal[e, 1]
        # the normal in j's axes, so that its corners needn't be turned
        fx, fy = cr * ex + sr * ey, -sr * ex + cr * ey
        least = 1e300
        for v in range(shapes.corner[j], shapes.corner[j + 1]):
            least = min(least, fx * shapes.vertices[v, 0] + fy * shapes.vertices[v, 1])
        beyond = least + ex * dx + ey * dy - shapes.offset[e]
        if beyond > best:
            best, nx, ny = beyond, c * ex - s * ey, s * ex + c * ey
    return best, flip * nx, flip * ny


@kernel
def corner_of(shapes, v, pose, c, s, x, y):
    """A corner in the world, measured from ``(x, y)``."""
    vx, vy = shapes.vertices[v, 0], shapes.vertices[v, 1]
    return pose[0] - x + c * vx - s * vy, pose[1] - y + s * vx + c * vy


@kernel
def nearest_corner(shapes, i, j, pi, pj, flip):
    """The least distance from a corner of ``j`` to an edge of ``i``, in front of it or from one of its ends.

    Returns (distance; unit direction from ``i`` to ``j``, turned round where ``flip`` is -1). Where the nearest point
    lies inside an edge the direction is that edge's normal, which has all its digits however small the distance.
    """
    ci, si, cj, sj = cos(pi[2]), sin(pi[2]), cos(pj[2]), sin(pj[2])
    best, nx, ny = 1e300, 0.0, 0.0
    start, end = shapes.corner[i], shapes.corner[i + 1]
    for v in range(shapes.corner[j], shapes.corner[j + 1]):
        qx, qy = corner_of(shapes, v, pj, cj, sj, pi[0], pi[1])
        for e in range(start, end):
            ax, ay = corner_of(shapes, e, pi, ci, si, pi[0], pi[1])
            bx, by = corner_of(shapes, e + 1 if e + 1 < end else start, pi, ci, si, pi[0], pi[1])
            ux, uy = bx - ax, by - ay
            along = (ux * (qx - ax) + uy * (qy - ay)) / (ux * ux + uy * uy)
            if 0.0 < along < 1.0:
                ex = ci * shapes.normal[e, 0] - si * shapes.normal[e, 1]
                ey = si * shapes.normal[e, 0] + ci * shapes.normal[e, 1]
                distance = ex * (qx - ax) + ey * (qy - ay)
                if distance >= 0.0 and distance < best:
                    best, nx, ny = distance, ex, ey
            else:
                far = min(max(along, 0.0), 1.0)
                rx, ry = qx - (ax + far * ux), qy - (ay + far * uy)
                distance = hypot(rx, ry)
                if COINCIDENT < distance < best:
                    best, nx, ny = distance, rx / distance, ry / distance
    return best, flip * nx, flip * ny


@kernel
def gap(shapes, i, j, pi, pj):
    """Signed distance of two shapes and its direction.

    Returns (distance, or minus the depth of the least push that would part them; unit normal from ``i`` to ``j``).
    """
    first, nx, ny = widest(shapes, i, j, pi, pj, at.FORWARD)
    second, mx, my = widest(shapes, j, i, pj, pi, at.BACKWARD)
    if second > first:
        first, nx, ny = second, mx, my
    if first <= COINCIDENT:
        return first, nx, ny
    best, bx, by = nearest_corner(shapes, i, j, pi, pj, at.FORWARD)
    other, ox, oy = nearest_corner(shapes, j, i, pj, pi, at.BACKWARD)
    if other < best:
        best, bx, by = other, ox, oy
    if best <= first + COINCIDENT:
        # the direction between corners a nanometre apart is rounding: over a face it would lose the gap
        return first, nx, ny
    return best, bx, by


@kernel
def reach(shapes, i, pose, x, y, nx, ny, turn, ahead):
    """How far a shape reaches along a direction when its corners go on for ``ahead`` seconds as they move now.

    ``pose`` is a state x, y, theta, vx, vy, omega; measured from ``(x, y)``, about which the direction turns at
    ``turn``, rad/s, to first order.
    """
    c, s = cos(pose[2]), sin(pose[2])
    mx, my = nx - ahead * turn * ny, ny + ahead * turn * nx
    most = -1e300
    for v in range(shapes.corner[i], shapes.corner[i + 1]):
        vx, vy = shapes.vertices[v, 0], shapes.vertices[v, 1]
        rx, ry = c * vx - s * vy, s * vx + c * vy
        wx, wy = pose[at.UX] - pose[at.OMEGA] * ry, pose[at.UY] + pose[at.OMEGA] * rx
        here = mx * (pose[0] - x + rx) + my * (pose[1] - y + ry)
        most = max(most, here + ahead * (nx * wx + ny * wy))
    return most


@kernel
def between(shapes, i, j, pi, pj, nx, ny, turn, ahead):
    """The free space between two shapes along the direction from ``i`` to ``j``, ``ahead`` seconds on.

    The direction turns at ``turn``, rad/s.
    """
    x, y = pi[0], pi[1]
    mine = reach(shapes, i, pi, x, y, nx, ny, turn, ahead)
    return -mine - reach(shapes, j, pj, x, y, -nx, -ny, turn, ahead)


@kernel
def extent(shapes, i):
    """Farthest corner of a shape from its point, m."""
    most = 0.0
    for v in range(shapes.corner[i], shapes.corner[i + 1]):
        most = max(most, hypot(shapes.vertices[v, 0], shapes.vertices[v, 1]))
    return most


@kernel
def turning_pull(shapes, i, j, pi, pj, turn, span, pull):
    """Acceleration that corners have at most along a direction that turns at ``turn``, where they have ``pull``."""
    if turn == 0.0:
        return pull
    across, apart = extent(shapes, i), extent(shapes, j)
    speed = abs(pi[at.OMEGA]) * across + abs(pj[at.OMEGA]) * apart + pull * span
    speed += hypot(pj[at.UX] - pi[at.UX], pj[at.UY] - pi[at.UY])
    distance = across + apart + hypot(pj[0] - pi[0], pj[1] - pi[1]) + speed * span
    return pull + abs(turn) * (2.0 * speed + abs(turn) * distance)


@kernel
def parted(shapes, i, j, pi, pj, qi, qj, direction, turn, span, pull):
    """Whether a line that turns at ``turn`` parts two shapes all the way from one instant to another ``span`` on.

    ``direction`` is `gap` at the first, which is the later one where ``span`` is negative.
    """
    free, nx, ny = direction
    stray = turning_pull(shapes, i, j, pi, pj, turn, abs(span), pull) * span * span
    if between(shapes, i, j, pi, pj, nx, ny, turn, span) > 0.5 * stray:
        return True
    if free <= 0.125 * stray:
        return False
    c, s = cos(turn * span), sin(turn * span)
    nx, ny = c * nx - s * ny, s * nx + c * ny
    return between(shapes, i, j, qi, qj, nx, ny, 0.0, 0.0) > 0.125 * stray


@kernel
def stays_clear(shapes, i, j, pi, qi, pj, qj, span, pull):
    """Whether two shapes certainly don't meet between two instants ``span`` apart.

    There is a line between them all the time if one of their lines at either end stays between the corners' ways, fixed
    or turning as one of them does, like the line along an edge that a corner comes near. Along it no corner gains speed
    faster than ``pull`` (both shapes' together) and what turning adds: it is within ``pull span² / 8`` of the straight
    way from start to end, and within ``pull t² / 2`` of where its present velocity takes it.

    Args:
        shapes: ``plant.effects.parcel_contact.bodies.Shapes``.
        i: one shape.
        j: the other.
        pi: ``(6,)`` state of ``i`` at the start.
        qi: at the end.
        pj: of ``j`` at the start.
        qj: at the end.
        span: s.
        pull: m/s².
    """
    start = gap(shapes, i, j, pi, pj)
    if start[0] <= 0.0:
        return False
    if parted(shapes, i, j, pi, pj, qi, qj, start, 0.0, span, pull):
        return True
    end = gap(shapes, i, j, qi, qj)
    if end[0] <= 0.0:
        return False
    if parted(shapes, i, j, qi, qj, pi, pj, end, 0.0, -span, pull):
        return True
    for k in range(2):
        turn = pj[at.OMEGA] if k == 1 else pi[at.OMEGA]
        if turn != 0.0 and (
            parted(shapes, i, j, pi, pj, qi, qj, start, turn, span, pull)
            or parted(shapes, i, j, qi, qj, pi, pj, end, turn, -span, pull)
        ):
            return True
    return False
