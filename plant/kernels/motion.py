"""Accelerations of a parcel at one instant, and the loads of captured cells that keep their surfaces still."""

from __future__ import annotations

from plant.kernels.jit import kernel
from plant.kernels.layout import (
    A_1,
    A_2,
    A_C,
    A_S,
    CAPTURED,
    CELL,
    CX,
    CY,
    DECAY,
    EDGE,
    G0,
    G1X,
    G1Y,
    GROUP,
    K0X,
    K0Y,
    K1XX,
    K1XY,
    K1YX,
    K1YY,
    KAPPA,
    MARK,
    MASS_OVER_INERTIA,
    N_ACTIVE,
    N_GROUPS,
    N_MEMBERS,
    OMEGA,
    PXX,
    PXY,
    PYY,
    S_BX,
    S_BY,
    S_RB,
    S_RV,
    S_RX,
    S_RY,
    S_VX,
    S_VY,
    S_W,
    S_WRR,
    S_WRX,
    S_WRY,
    STEADY,
    T0,
    T1X,
    T1Y,
    THETA,
    UX,
    UY,
    W0,
    W1X,
    W1Y,
    W2XX,
    W2XY,
    W2YY,
    B,
)  # fmt: skip


@kernel
def traction(seg, a0, bx, by, e, y, kappa, kappa_inertia):
    """Acceleration from the active supports' loads ``a0 + b . r`` (eqs. 16-17, 21-22 with loads kept general).

    ``e`` is the motors' decay factor now. Returns (ax, ay, alpha).
    """
    s, d = STEADY, DECAY
    dx = a0 * (seg[s + K0X] + e * seg[d + K0X]) + bx * (seg[s + K1XX] + e * seg[d + K1XX])
    dx += by * (seg[s + K1XY] + e * seg[d + K1XY])
    dy = a0 * (seg[s + K0Y] + e * seg[d + K0Y]) + bx * (seg[s + K1YX] + e * seg[d + K1YX])
    dy += by * (seg[s + K1YY] + e * seg[d + K1YY])
    turn = a0 * (seg[s + T0] + e * seg[d + T0]) + bx * (seg[s + T1X] + e * seg[d + T1X])
    turn += by * (seg[s + T1Y] + e * seg[d + T1Y])
    s0 = a0 * seg[W0] + bx * seg[W1X] + by * seg[W1Y]
    s1x = a0 * seg[W1X] + bx * seg[W2XX] + by * seg[W2XY]
    s1y = a0 * seg[W1Y] + bx * seg[W2XY] + by * seg[W2YY]
    c2 = a0 * seg[G0] + bx * seg[G1X] + by * seg[G1Y]
    return combine(dx, dy, turn, s0, s1x, s1y, c2, -seg[CX], -seg[CY], y, kappa, kappa_inertia)


@kernel
def combine(dx, dy, turn, s0, s1x, s1y, c2, xix, xiy, y, kappa, kappa_inertia):
    """Force and torque per unit from the moments: ``D - S0 U - omega J B`` and ``T - xi x D - B x U - omega C``."""
    bx, by = s1x - s0 * xix, s1y - s0 * xiy
    c = c2 - 2.0 * (xix * s1x + xiy * s1y) + (xix * xix + xiy * xiy) * s0
    ax = kappa * (dx - s0 * y[UX] + y[OMEGA] * by)
    ay = kappa * (dy - s0 * y[UY] - y[OMEGA] * bx)
    torque = turn - (xix * dy - xiy * dx) - (bx * y[UY] - by * y[UX]) - y[OMEGA] * c
    return ax, ay, kappa_inertia * torque


@kernel
def response(seg, g, e, y, kappa, kappa_inertia):
    """Acceleration that one unit of load on a captured group adds (the active supports give way to it)."""
    da = -1.0 / seg[N_ACTIVE]
    dbx = -(seg[PXX] * g[S_RX] + seg[PXY] * g[S_RY])
    dby = -(seg[PXY] * g[S_RX] + seg[PYY] * g[S_RY])
    ax, ay, al = traction(seg, da, dbx, dby, e, y, kappa, kappa_inertia)
    bx, by, bl = combine(
        g[S_VX] + e * g[S_BX], g[S_VY] + e * g[S_BY], g[S_RV] + e * g[S_RB], g[S_W], g[S_WRX], g[S_WRY], g[S_WRR],
        -seg[CX], -seg[CY], y, kappa, kappa_inertia,
    )  # fmt: skip
    return ax + bx, ay + by, al + bl


@kernel
def surfaces(pos, normal, offset, mem, share, ctl, y, grp):
    """Coefficients of each group's surface ``sigma = B + A_C cos + A_S sin + A_1 E1 + A_2 E2``.

    ``sigma`` is the (share-weighted mean) distance of the group's cells inside their edges, ``E1 = cos Yx + sin Yy``,
    ``E2 = -sin Yx + cos Yy``, ``Y = X - X0``.
    """
    for i in range(ctl[N_MEMBERS]):
        if mem[i, MARK] != CAPTURED:
            continue
        h, cell, edge, s = mem[i, GROUP], mem[i, CELL], mem[i, EDGE], share[i]
        px, py = pos[cell, 0] - y[0], pos[cell, 1] - y[1]
        nx, ny = normal[edge, 0], normal[edge, 1]
        grp[h, B] += s * offset[edge]
        grp[h, A_C] -= s * (nx * px + ny * py)
        grp[h, A_S] -= s * (nx * py - ny * px)
        grp[h, A_1] += s * nx
        grp[h, A_2] += s * ny


@kernel
def surface_rates(g, y, c, s, ax, ay, al):
    """``sigma``, its rate and its second rate, for motion with the accelerations given."""
    om, ux, uy = y[OMEGA], y[UX], y[UY]
    value = g[B] + g[A_C] * c + g[A_S] * s
    rate = om * (-g[A_C] * s + g[A_S] * c) + g[A_1] * (c * ux + s * uy) + g[A_2] * (-s * ux + c * uy)
    second = g[A_C] * (-c * om * om - s * al) + g[A_S] * (-s * om * om + c * al)
    second += g[A_1] * (2.0 * om * (-s * ux + c * uy) + c * ax + s * ay)
    second += g[A_2] * (2.0 * om * (-c * ux - s * uy) - s * ax + c * ay)
    return value, rate, second


@kernel
def surface_slope(g, c, s, dx, dy, dth):
    """Change of ``sigma`` for a small displacement ``(dx, dy, dth)``."""
    return dth * (-g[A_C] * s + g[A_S] * c) + g[A_1] * (c * dx + s * dy) + g[A_2] * (-s * dx + c * dy)


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

    Fills ``matrix[g, h]`` (second rate of surface g per unit load on h), ``reply[h]`` (acceleration per unit load
    on h) and ``f``. Returns (ax, ay, alpha, conditioning); conditioning is 1 without captured groups.
    """
    kappa = par[KAPPA]
    kappa_inertia = kappa * par[MASS_OVER_INERTIA]
    a0, xix, xiy = 1.0 / seg[N_ACTIVE], -seg[CX], -seg[CY]
    bx, by = seg[PXX] * xix + seg[PXY] * xiy, seg[PXY] * xix + seg[PYY] * xiy
    ax, ay, al = traction(seg, a0, bx, by, e, y, kappa, kappa_inertia)
    groups = ctl[N_GROUPS]
    if groups == 0:
        return ax, ay, al, 1.0
    for h in range(groups):
        reply[h, 0], reply[h, 1], reply[h, 2] = response(seg, grp[h], e, y, kappa, kappa_inertia)
    for g in range(groups):
        _, _, second = surface_rates(grp[g], y, c, s, ax, ay, al)
        reply[g, 3] = -second
        for h in range(groups):
            matrix[g, h] = surface_slope(grp[g], c, s, reply[h, 0], reply[h, 1], reply[h, 2])
    conditioning = solve(matrix, groups, reply[:, 3], f, scratch)
    if conditioning > 0.0:
        for h in range(groups):
            ax += f[h] * reply[h, 0]
            ay += f[h] * reply[h, 1]
            al += f[h] * reply[h, 2]
    return ax, ay, al, conditioning


@kernel
def onto_surfaces(grp, groups, y, c, s, matrix, reply, rhs, change, scratch):
    """Move state and velocity of a captured parcel back onto its surfaces, along the captured loads' own push."""
    for g in range(groups):
        _, rate, _ = surface_rates(grp[g], y, c, s, 0.0, 0.0, 0.0)
        rhs[g] = -rate
    solve(matrix, groups, rhs, change, scratch)
    for h in range(groups):
        y[UX] += change[h] * reply[h, 0]
        y[UY] += change[h] * reply[h, 1]
        y[OMEGA] += change[h] * reply[h, 2]
    for g in range(groups):
        value, _, _ = surface_rates(grp[g], y, c, s, 0.0, 0.0, 0.0)
        rhs[g] = -value
    solve(matrix, groups, rhs, change, scratch)
    for h in range(groups):
        y[0] += change[h] * reply[h, 0]
        y[1] += change[h] * reply[h, 1]
        y[THETA] += change[h] * reply[h, 2]
