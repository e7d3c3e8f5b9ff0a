"""Accelerations of a parcel at one instant, and the mixture of modes that keeps captured surfaces still."""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at

NEWTON_STEPS = 40
"""More than enough for fractions that exist."""
SECOND_ZERO = 1e-14
"""A share of the largest second rate that is zero to rounding."""


@kernel
def plane(seg):
    """The springs' plane now (eqs. 3-13): load share ``a0 + b . r`` of a cell at r from the centroid."""
    mx, my = -seg[at.CX], -seg[at.CY]
    return 1.0 / seg[at.N_ACTIVE], seg[at.PXX] * mx + seg[at.PXY] * my, seg[at.PXY] * mx + seg[at.PYY] * my


@kernel
def linear(seg, first, a0, bx, by):
    """One of a support set's sums on the plane ``a0 + b . r``; ``first`` is its first coefficient."""
    return a0 * seg[first] + bx * seg[first + 1] + by * seg[first + 2]


@kernel
def drive(seg, row, e, a0, bx, by):
    """Compute the present drive along ``row`` of ``seg``, including the decaying part of the motors."""
    s, d = at.STEADY + row, at.DECAY + row
    total = a0 * (seg[s] + e * seg[d]) + bx * (seg[s + 1] + e * seg[d + 1])
    return total + by * (seg[s + 2] + e * seg[d + 2])


@kernel
def traction(seg, e, y, par):
    """Acceleration that one support set's wheels give (eqs. 16-17, 21-22 with loads and the law kept general).

    ``e`` is the motors' decay factor now. Returns (ax, ay, alpha).
    """
    a0, bx, by = plane(seg)
    dx, dy = drive(seg, at.DX, e, a0, bx, by), drive(seg, at.DY, e, a0, bx, by)
    turn = drive(seg, at.T, e, a0, bx, by)
    s0x, s0y = linear(seg, at.S0X, a0, bx, by), linear(seg, at.S0Y, a0, bx, by)
    s1x, s1y = linear(seg, at.S1X, a0, bx, by), linear(seg, at.S1Y, a0, bx, by)
    xix, xiy, ux, uy, om = -seg[at.CX], -seg[at.CY], y[at.UX], y[at.UY], y[at.OMEGA]
    # the resistances' moments about the centre of mass: of those along x with the lever y, and the other way round
    qx, qy = s1x - s0x * xiy, s1y - s0y * xix
    c = linear(seg, at.C2, a0, bx, by) - 2.0 * (xix * s1y + xiy * s1x) + (xix * xix * s0y + xiy * xiy * s0x)
    kappa = par[at.KAPPA]
    ax = kappa * (dx - s0x * ux + om * qx)
    ay = kappa * (dy - s0y * uy - om * qy)
    torque = turn - (xix * dy - xiy * dx) - (qy * uy - qx * ux) - om * c
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
def differences(values, groups):
    """Turn what each mode has into what each set of groups adds by being on its far side (Moebius transform).

    ``values[m]`` becomes the sum over subsets b of m of ``(-1)**|m - b| values[b]``: with fractions f, the mixture is
    then the sum over m of ``values[m]`` times the product of the fractions in m.
    """
    for h in range(groups):
        for m in range(1 << groups):
            if m & (1 << h):
                for k in range(values.shape[1]):
                    values[m, k] -= values[m ^ (1 << h), k]


@kernel
def product_of(fraction, groups, m):
    """Product of the fractions of the groups whose bits are set in m."""
    share = 1.0
    for h in range(groups):
        if m & (1 << h):
            share *= fraction[h]
    return share


@kernel
def share_of(fraction, groups, m):
    """Which share of the motion is that of mode m: the product of the fractions of its sides."""
    share = 1.0
    for h in range(groups):
        share *= fraction[h] if m & (1 << h) else 1.0 - fraction[h]
    return share


@kernel
def mixture(work, groups):
    """The surfaces' second rates at the present fractions, and how they and the accelerations change with each.

    Fills ``work.reply[:3, h]`` and ``work.matrix[g, h]`` (derivatives with respect to fraction h) and
    ``work.reply[3, g]`` (minus the second rate of surface g) from what ``differences`` left in ``work``.
    """
    add, second, fraction, matrix, reply = work.adds, work.seconds, work.fraction, work.matrix, work.reply
    for h in range(groups):
        reply[0, h] = reply[1, h] = reply[2, h] = reply[3, h] = 0.0
        for g in range(groups):
            matrix[g, h] = 0.0
    for m in range(1 << groups):
        share = product_of(fraction, groups, m)
        for g in range(groups):
            reply[3, g] -= share * second[m, g]
        for h in range(groups):
            if m & (1 << h):
                share = product_of(fraction, groups, m ^ (1 << h))
                for k in range(3):
                    reply[k, h] += share * add[m, k]
                for g in range(groups):
                    matrix[g, h] += share * second[m, g]


@kernel
def find_fractions(work, groups, size):
    """Fractions at which every surface's second rate is zero, by Newton's method; ``size`` is that of the rates.

    Returns the conditioning of the last step's equations, 0 where no fractions are found.
    """
    for h in range(groups):
        # one group's equation is linear: from zero, the first step is exact
        work.fraction[h] = 0.0 if groups == 1 else 0.5
    for _ in range(NEWTON_STEPS):
        mixture(work, groups)
        off = 0.0
        for g in range(groups):
            off = max(off, abs(work.reply[3, g]))
        conditioning = solve(work.matrix, groups, work.reply[3], work.change, work.scratch)
        if conditioning == 0.0 or off <= SECOND_ZERO * size:
            return conditioning
        for h in range(groups):
            work.fraction[h] += work.change[h]
    return 0.0


@kernel
def accelerations(parcel, work, e, c, s):
    """Acceleration now: the modes' own, mixed so that each captured surface's second rate is zero (Filippov).

    A mode's share is the product over the groups of the fractions of their sides. With one group that is Filippov's
    rule; with more, the rule leaves the shares open unless loads are linear in them, and this choice, every group's
    side independent of the others', is Alexander and Seidman's (Houston J. Math. 24, 1998).

    Fills ``work.fraction``, and at it ``work.reply[:3, h]`` (slope of the acceleration along fraction h) and
    ``work.matrix[g, h]`` (the same for the second rate of surface g). Returns (ax, ay, alpha, conditioning);
    conditioning is 1 without captured groups, 0 where no fractions are found.
    """
    y, add, second = parcel.y, work.adds, work.seconds
    groups = parcel.ctl[at.N_GROUPS]
    for m in range(1 << groups):
        add[m, 0], add[m, 1], add[m, 2] = traction(work.segs[m], e, y, parcel.par)
    if groups == 0:
        return add[0, 0], add[0, 1], add[0, 2], 1.0
    size = 0.0
    for m in range(1 << groups):
        for g in range(groups):
            _, _, second[m, g] = surface_rates(work.grp[g], y, c, s, add[m, 0], add[m, 1], add[m, 2])
            size = max(size, abs(second[m, g]))
    differences(add, groups)
    differences(second, groups)
    conditioning = find_fractions(work, groups, size)
    ax = ay = al = 0.0
    for m in range(1 << groups):
        share = product_of(work.fraction, groups, m)
        ax += share * add[m, 0]
        ay += share * add[m, 1]
        al += share * add[m, 2]
    return ax, ay, al, conditioning


@kernel
def onto_surfaces(parcel, work, c, s):
    """Move state and velocity of a captured parcel back onto its surfaces, along the push by which its modes differ."""
    y, grp, matrix, reply, change = parcel.y, work.grp, work.matrix, work.reply, work.change
    rhs, groups = reply[3], parcel.ctl[at.N_GROUPS]
    for g in range(groups):
        _, rate, _ = surface_rates(grp[g], y, c, s, 0.0, 0.0, 0.0)
        rhs[g] = -rate
    solve(matrix, groups, rhs, change, work.scratch)
    for h in range(groups):
        y[at.UX] += change[h] * reply[0, h]
        y[at.UY] += change[h] * reply[1, h]
        y[at.OMEGA] += change[h] * reply[2, h]
    for g in range(groups):
        value, _, _ = surface_rates(grp[g], y, c, s, 0.0, 0.0, 0.0)
        rhs[g] = -value
    solve(matrix, groups, rhs, change, work.scratch)
    for h in range(groups):
        y[0] += change[h] * reply[0, h]
        y[1] += change[h] * reply[1, h]
        y[at.THETA] += change[h] * reply[2, h]
