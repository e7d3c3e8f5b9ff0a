"""Accelerations of a parcel at one instant, and the loads of captured cells that keep their surfaces still."""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel


@kernel
def traction(seg, a0, bx, by, e, y, kappa, kappa_inertia):
    """Acceleration from the active supports' loads ``a0 + b . r`` (eqs. 16-17, 21-22 with loads kept general).

    ``e`` is the motors' decay factor now. Returns (ax, ay, alpha).
    """
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
    return combine(dx, dy, turn, s0, s1x, s1y, c2, -seg[at.CX], -seg[at.CY], y, kappa, kappa_inertia)


@kernel
def combine(dx, dy, turn, s0, s1x, s1y, c2, xix, xiy, y, kappa, kappa_inertia):
    """Force and torque per unit from the moments: ``D - S0 U - omega J B`` and ``T - xi x D - B x U - omega C``."""
    bx, by = s1x - s0 * xix, s1y - s0 * xiy
    c = c2 - 2.0 * (xix * s1x + xiy * s1y) + (xix * xix + xiy * xiy) * s0
    ax = kappa * (dx - s0 * y[at.UX] + y[at.OMEGA] * by)
    ay = kappa * (dy - s0 * y[at.UY] - y[at.OMEGA] * bx)
    torque = turn - (xix * dy - xiy * dx) - (bx * y[at.UY] - by * y[at.UX]) - y[at.OMEGA] * c
    return ax, ay, kappa_inertia * torque


@kernel
def response(seg, g, e, y, kappa, kappa_inertia):
    """Acceleration that one unit of load on a captured group adds (the active supports give way to it)."""
    da = -g[at.S_SUM] / seg[at.N_ACTIVE]
    dbx = -(seg[at.PXX] * g[at.S_RX] + seg[at.PXY] * g[at.S_RY])
    dby = -(seg[at.PXY] * g[at.S_RX] + seg[at.PYY] * g[at.S_RY])
    ax, ay, al = traction(seg, da, dbx, dby, e, y, kappa, kappa_inertia)
    vx, vy, turn = g[at.S_VX] + e * g[at.S_BX], g[at.S_VY] + e * g[at.S_BY], g[at.S_RV] + e * g[at.S_RB]
    s0, s1x, s1y, c2 = g[at.S_W], g[at.S_WRX], g[at.S_WRY], g[at.S_WRR]
    bx, by, bl = combine(vx, vy, turn, s0, s1x, s1y, c2, -seg[at.CX], -seg[at.CY], y, kappa, kappa_inertia)
    return ax + bx, ay + by, al + bl


@kernel
def surfaces(pos, normal, offset, mem, share, ctl, y, grp):
    """Coefficients of each group's surface ``sigma = B + A_C cos + A_S sin + A_1 E1 + A_2 E2``.

    ``sigma`` is the (share-weighted mean) distance of the group's cells inside their edges, ``E1 = cos Yx + sin Yy``,
    ``E2 = -sin Yx + cos Yy``, ``Y = X - X0``.
    """
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.MARK] != at.CAPTURED:
            continue
        h, cell, edge, s = mem[i, at.GROUP], mem[i, at.CELL], mem[i, at.EDGE], share[i, at.SHARE]
        px, py = pos[cell, 0] - y[0], pos[cell, 1] - y[1]
        nx, ny = normal[edge, 0], normal[edge, 1]
        grp[h, at.B] += s * offset[edge]
        grp[h, at.A_C] -= s * (nx * px + ny * py)
        grp[h, at.A_S] -= s * (nx * py - ny * px)
        grp[h, at.A_1] += s * nx
        grp[h, at.A_2] += s * ny


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
def accelerations(seg, grp, ctl, y, par, e, c, s, matrix, reply, f, scratch):
    """Acceleration now, with the loads ``f`` of captured groups that keep each surface's second rate at zero.

    Fills ``matrix[g, h]`` (second rate of surface g per unit load on h), ``reply[:3, h]`` (acceleration per unit load
    on h) and ``f``. Returns (ax, ay, alpha, conditioning); conditioning is 1 without captured groups.
    """
    kappa = par[at.KAPPA]
    kappa_inertia = kappa * par[at.MASS_OVER_INERTIA]
    a0, xix, xiy = 1.0 / seg[at.N_ACTIVE], -seg[at.CX], -seg[at.CY]
    bx, by = seg[at.PXX] * xix + seg[at.PXY] * xiy, seg[at.PXY] * xix + seg[at.PYY] * xiy
    ax, ay, al = traction(seg, a0, bx, by, e, y, kappa, kappa_inertia)
    groups = ctl[at.N_GROUPS]
    if groups == 0:
        return ax, ay, al, 1.0
    bx, by, bl = response(seg, grp[at.FIXED], e, y, kappa, kappa_inertia)
    ax, ay, al = ax + bx, ay + by, al + bl
    for h in range(groups):
        reply[0, h], reply[1, h], reply[2, h] = response(seg, grp[h], e, y, kappa, kappa_inertia)
    for g in range(groups):
        _, _, second = surface_rates(grp[g], y, c, s, ax, ay, al)
        reply[3, g] = -second
        for h in range(groups):
            matrix[g, h] = surface_slope(grp[g], c, s, reply[0, h], reply[1, h], reply[2, h])
    conditioning = solve(matrix, groups, reply[3], f, scratch)
    if conditioning > 0.0:
        for h in range(groups):
            ax += f[h] * reply[0, h]
            ay += f[h] * reply[1, h]
            al += f[h] * reply[2, h]
    return ax, ay, al, conditioning


@kernel
def onto_surfaces(grp, groups, y, c, s, matrix, reply, rhs, change, scratch):
    """Move state and velocity of a captured parcel back onto its surfaces, along the captured loads' own push."""
    for g in range(groups):
        _, rate, _ = surface_rates(grp[g], y, c, s, 0.0, 0.0, 0.0)
        rhs[g] = -rate
    solve(matrix, groups, rhs, change, scratch)
    for h in range(groups):
        y[at.UX] += change[h] * reply[0, h]
        y[at.UY] += change[h] * reply[1, h]
        y[at.OMEGA] += change[h] * reply[2, h]
    for g in range(groups):
        value, _, _ = surface_rates(grp[g], y, c, s, 0.0, 0.0, 0.0)
        rhs[g] = -value
    solve(matrix, groups, rhs, change, scratch)
    for h in range(groups):
        y[0] += change[h] * reply[0, h]
        y[1] += change[h] * reply[1, h]
        y[at.THETA] += change[h] * reply[2, h]
