"""Accelerations of a parcel at one instant, and the mixture of modes that keeps captured surfaces still."""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel


@kernel
def plane(seg):
    """The springs' plane now (eqs. 3-13): load share ``a0 + b . r`` of a cell at r from the centroid."""
    mx, my = -seg[at.CX], -seg[at.CY]
    return 1.0 / seg[at.N_ACTIVE], seg[at.PXX] * mx + seg[at.PXY] * my, seg[at.PXY] * mx + seg[at.PYY] * my


@kernel
def traction(seg, e, y, par):
    """Acceleration that one support set's loads give (eqs. 16-17, 21-22 with loads kept general).

    ``e`` is the motors' decay factor now. Returns (ax, ay, alpha).
    """
    a0, bx, by = plane(seg)
    s, d = at.STEADY, at.DECAY
    dx = a0 * (seg[s + at.K0X] + e * seg[d + at.K0X]) + bx * (seg[s + at.K1XX] + e * seg[d + at.K1XX])
    dx += by * (seg[s + at.K1XY] + e * seg[d + at.K1XY])
    dy = a0 * (seg[s + at.K0Y] + e * seg[d + at.K0Y]) + bx * (seg[s + at.K1YX] + e * seg[d + at.K1YX])
    dy += by * (seg[s + at.K1YY] + e * seg[d + at.K1YY])
    turn = a0 * (seg[s + at.T0] + e * seg[d + at.T0]) + bx * (seg[s + at.T1X] + e * seg[d + at.T1X])
    turn += by * (seg[s + at.T1Y] + e * seg[d + at.T1Y])
    s0 = a0 * seg[at.W0] + bx * seg[at.W1X] + by * seg[at.W1Y]
    s1x = a0 * seg[at.W1X] + bx * seg[at.W2XX] + by * seg[at.W2XY]
    s1y = a0 * seg[at.W1Y] + bx * seg[at.W2XY] + by * seg[at.W2YY]
    c2 = a0 * seg[at.G0] + bx * seg[at.G1X] + by * seg[at.G1Y]
    xix, xiy = -seg[at.CX], -seg[at.CY]
    bx, by = s1x - s0 * xix, s1y - s0 * xiy
    c = c2 - 2.0 * (xix * s1x + xiy * s1y) + (xix * xix + xiy * xiy) * s0
    kappa = par[at.KAPPA]
    ax = kappa * (dx - s0 * y[at.UX] + y[at.OMEGA] * by)
    ay = kappa * (dy - s0 * y[at.UY] - y[at.OMEGA] * bx)
    torque = turn - (xix * dy - xiy * dx) - (bx * y[at.UY] - by * y[at.UX]) - y[at.OMEGA] * c
    return ax, ay, kappa * par[at.MASS_OVER_INERTIA] * torque


@kernel
def surfaces(surface, parcel, grp):
    """Coefficients of each group's surface ``sigma = B + A_C cos + A_S sin + A_1 E1 + A_2 E2``.

    ``sigma`` is positive on the far side: the mean distance of the group's cells inside their edges, counted the other
    way for those that are under the parcel on the near side. ``E1 = cos Yx + sin Yy``, ``E2 = -sin Yx + cos Yy``,
    ``Y = X - X0``.
    """
    mem, ctl, y = parcel.mem, parcel.ctl, parcel.y
    for h in range(ctl[at.N_GROUPS]):
        for k in range(at.GRP_SIZE):
            grp[h, k] = 0.0
    for i in range(ctl[at.N_MEMBERS]):
        side = mem[i, at.SIDE]
        if side != 0:
            h, cell, edge = mem[i, at.GROUP], mem[i, at.CELL], mem[i, at.EDGE]
            px, py = surface.pos[cell, 0] - y[0], surface.pos[cell, 1] - y[1]
            nx, ny = parcel.normal[edge, 0], parcel.normal[edge, 1]
            grp[h, at.B] += side * parcel.offset[edge]
            grp[h, at.A_C] -= side * (nx * px + ny * py)
            grp[h, at.A_S] -= side * (nx * py - ny * px)
            grp[h, at.A_1] += side * nx
            grp[h, at.A_2] += side * ny
            grp[h, at.N_CELLS] += 1.0
    for h in range(ctl[at.N_GROUPS]):
        for k in range(at.N_CELLS):
            grp[h, k] /= grp[h, at.N_CELLS]


@kernel
def surface_rates(g, y, c, s, ax, ay, al):
    """``sigma``, its rate and its second rate, for motion with the accelerations given."""
    om, ux, uy = y[at.OMEGA], y[at.UX], y[at.UY]
    value = g[at.B] + g[at.A_C] * c + g[at.A_S] * s
    rate = (
        om * (-g[at.A_C] * s + g[at.A_S] * c) + g[at.A_1] * (c * ux + s * uy) + g[at.A_2] * (-s * ux + c * uy)
    )
    second = g[at.A_C] * (-c * om * om - s * al) + g[at.A_S] * (-s * om * om + c * al)
    second += g[at.A_1] * (2.0 * om * (-s * ux + c * uy) + c * ax + s * ay)
    second += g[at.A_2] * (2.0 * om * (-c * ux - s * uy) - s * ax + c * ay)
    return value, rate, second


@kernel
def surface_slope(g, c, s, dx, dy, dth):
    """Change of ``sigma`` for a small displacement ``(dx, dy, dth)``."""
    return (
        dth * (-g[at.A_C] * s + g[at.A_S] * c)
        + g[at.A_1] * (c * dx + s * dy)
        + g[at.A_2] * (-s * dx + c * dy)
    )


@kernel
def solve(m, size, rhs, x, scratch):
    """Solve a system of up to three unknowns with pivoting. Returns the smallest pivot over the largest."""
    a = scratch
    for i in range(size):
        for j in range(size):
            a[i, j] = m[i, j]
        a[i, size] = rhs[i]
    smallest, largest = 1e300, 0.0
    for i in range(size):
        pivot = i
        for r in range(i + 1, size):
            if abs(a[r, i]) > abs(a[pivot, i]):
                pivot = r
        for j in range(size + 1):
            a[i, j], a[pivot, j] = a[pivot, j], a[i, j]
        size_of = abs(a[i, i])
        smallest, largest = min(smallest, size_of), max(largest, size_of)
        if size_of == 0.0:
            return 0.0
        for r in range(i + 1, size):
            factor = a[r, i] / a[i, i]
            for j in range(i, size + 1):
                a[r, j] -= factor * a[i, j]
    for i in range(size - 1, -1, -1):
        total = a[i, size]
        for j in range(i + 1, size):
            total -= a[i, j] * x[j]
        x[i] = total / a[i, i]
    return smallest / largest


@kernel
def accelerations(parcel, work, e, c, s):
    """Acceleration now: the modes' own, mixed so that each captured surface's second rate is zero (Filippov).

    Fills ``work.reply[:3, h]`` (how mode h + 1 differs from mode 0), ``work.matrix[g, h]`` (the same as second rate of
    surface g) and ``work.weight``. Returns (ax, ay, alpha, conditioning); conditioning is 1 without captured groups.
    """
    y, par, matrix, reply, weight = parcel.y, parcel.par, work.matrix, work.reply, work.weight
    ax, ay, al = traction(work.segs[0], e, y, par)
    groups = parcel.ctl[at.N_GROUPS]
    if groups == 0:
        return ax, ay, al, 1.0
    for h in range(groups):
        fx, fy, fl = traction(work.segs[h + 1], e, y, par)
        reply[0, h], reply[1, h], reply[2, h] = fx - ax, fy - ay, fl - al
    for g in range(groups):
        _, _, second = surface_rates(work.grp[g], y, c, s, ax, ay, al)
        reply[3, g] = -second
        for h in range(groups):
            matrix[g, h] = surface_slope(work.grp[g], c, s, reply[0, h], reply[1, h], reply[2, h])
    conditioning = solve(matrix, groups, reply[3], weight, work.scratch)
    if conditioning > 0.0:
        for h in range(groups):
            ax += weight[h] * reply[0, h]
            ay += weight[h] * reply[1, h]
            al += weight[h] * reply[2, h]
    return ax, ay, al, conditioning


@kernel
def onto_surfaces(parcel, work, c, s):
    """Move state and velocity of a captured parcel back onto its surfaces, along the push by which its modes differ."""
    y, grp, matrix, reply, weight = parcel.y, work.grp, work.matrix, work.reply, work.weight
    rhs, groups = reply[3], parcel.ctl[at.N_GROUPS]
    for g in range(groups):
        _, rate, _ = surface_rates(grp[g], y, c, s, 0.0, 0.0, 0.0)
        rhs[g] = -rate
    solve(matrix, groups, rhs, weight, work.scratch)
    for h in range(groups):
        y[at.UX] += weight[h] * reply[0, h]
        y[at.UY] += weight[h] * reply[1, h]
        y[at.OMEGA] += weight[h] * reply[2, h]
    for g in range(groups):
        value, _, _ = surface_rates(grp[g], y, c, s, 0.0, 0.0, 0.0)
        rhs[g] = -value
    solve(matrix, groups, rhs, weight, work.scratch)
    for h in range(groups):
        y[0] += weight[h] * reply[0, h]
        y[1] += weight[h] * reply[1, h]
        y[at.THETA] += weight[h] * reply[2, h]
