"""One Taylor step: coefficients of the motion to the order that the step needs, and the step's length.

Between events every quantity is a product of series (``dynamics``: translation linear, rotation linear with
polynomial coefficients, footprint through sine and cosine of the angle), so each coefficient follows from lower ones
by Cauchy products. Loads of captured cells are series too, fixed order by order by the surfaces' second rates.
"""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel
from plant.kernels.motion import solve


@kernel
def product(ser, a, b, k):
    """Coefficient k of the product of two series."""
    total = 0.0
    for j in range(k + 1):
        total += ser[a, j] * ser[b, k - j]
    return total


@kernel
def captured_load(groups, h, ser, k):
    """Coefficient k of the load on captured group h, and its row; after the last group the constant loads' own."""
    if h < groups:
        return ser[at.S_F + h, k], h
    return (1.0 if groups > 0 and k == 0 else 0.0), at.FIXED


@kernel
def linear_terms(seg, grp, groups, motors, ser, k):
    """Coefficient k of everything linear in the loads: D, T and, where wheels coast, S0, S1; and C2."""
    a0, bx, by = ser[at.S_A0, k], ser[at.S_BX_, k], ser[at.S_BY_, k]
    s = at.STEADY
    ser[at.S_DX, k] = a0 * seg[s + at.K0X] + bx * seg[s + at.K1XX] + by * seg[s + at.K1XY]
    ser[at.S_DY, k] = a0 * seg[s + at.K0Y] + bx * seg[s + at.K1YX] + by * seg[s + at.K1YY]
    ser[at.S_T, k] = a0 * seg[s + at.T0] + bx * seg[s + at.T1X] + by * seg[s + at.T1Y]
    ser[at.S_S0, k] = a0 * seg[at.W0] + bx * seg[at.W1X] + by * seg[at.W1Y]
    ser[at.S_S1X, k] = a0 * seg[at.W1X] + bx * seg[at.W2XX] + by * seg[at.W2XY]
    ser[at.S_S1Y, k] = a0 * seg[at.W1Y] + bx * seg[at.W2XY] + by * seg[at.W2YY]
    ser[at.S_C2, k] = a0 * seg[at.G0] + bx * seg[at.G1X] + by * seg[at.G1Y]
    for h in range(groups + 1):
        f, h = captured_load(groups, h, ser, k)
        ser[at.S_DX, k] += f * grp[h, at.S_VX]
        ser[at.S_DY, k] += f * grp[h, at.S_VY]
        ser[at.S_T, k] += f * grp[h, at.S_RV]
        ser[at.S_S0, k] += f * grp[h, at.S_W]
        ser[at.S_S1X, k] += f * grp[h, at.S_WRX]
        ser[at.S_S1Y, k] += f * grp[h, at.S_WRY]
        ser[at.S_C2, k] += f * grp[h, at.S_WRR]
    if motors:
        d = at.DECAY
        ser[at.S_DBX, k] = a0 * seg[d + at.K0X] + bx * seg[d + at.K1XX] + by * seg[d + at.K1XY]
        ser[at.S_DBY, k] = a0 * seg[d + at.K0Y] + bx * seg[d + at.K1YX] + by * seg[d + at.K1YY]
        ser[at.S_TB, k] = a0 * seg[d + at.T0] + bx * seg[d + at.T1X] + by * seg[d + at.T1Y]
        for h in range(groups + 1):
            f, h = captured_load(groups, h, ser, k)
            ser[at.S_DBX, k] += f * grp[h, at.S_BX]
            ser[at.S_DBY, k] += f * grp[h, at.S_BY]
            ser[at.S_TB, k] += f * grp[h, at.S_RB]
        ser[at.S_DX, k] += product(ser, at.S_EXP, at.S_DBX, k)
        ser[at.S_DY, k] += product(ser, at.S_EXP, at.S_DBY, k)
        ser[at.S_T, k] += product(ser, at.S_EXP, at.S_TB, k)


@kernel
def load_plane(seg, grp, groups, ser, k):
    """Coefficient k of the plane ``a0 + b . r`` of the active supports' loads."""
    mx, my = ser[at.S_XIX, k], ser[at.S_XIY, k]
    total = 1.0 if k == 0 else 0.0
    for h in range(groups + 1):
        f, h = captured_load(groups, h, ser, k)
        total -= f * grp[h, at.S_SUM]
        mx -= f * grp[h, at.S_RX]
        my -= f * grp[h, at.S_RY]
    ser[at.S_A0, k] = total / seg[at.N_ACTIVE]
    ser[at.S_BX_, k] = seg[at.PXX] * mx + seg[at.PXY] * my
    ser[at.S_BY_, k] = seg[at.PXY] * mx + seg[at.PYY] * my


@kernel
def acceleration_terms(seg, par, ser, k):
    """Coefficient k of (ax, ay, alpha)."""
    kappa = par[at.KAPPA]
    moment_x = moment_y = xx = yy = 0.0
    for j in range(k + 1):
        x, y = ser[at.S_XIX, j], ser[at.S_XIY, j]
        moment_x += x * ser[at.S_DY, k - j]
        moment_y += y * ser[at.S_DX, k - j]
        xx += x * ser[at.S_XIX, k - j]
        yy += y * ser[at.S_XIY, k - j]
    torque = ser[at.S_T, k] - moment_x + moment_y
    square = xx + yy
    if seg[at.DRIVEN] == 1.0:
        ser[at.S_CC, k] = ser[at.S_C2, k] - square
        ax = kappa * (ser[at.S_DX, k] - ser[at.S_UX, k])
        ay = kappa * (ser[at.S_DY, k] - ser[at.S_UY, k])
    else:
        # coasting wheels carry load but pull nothing: resistance no longer acts at the centre of mass
        ser[at.S_BBX, k] = ser[at.S_S1X, k] - product(ser, at.S_S0, at.S_XIX, k)
        ser[at.S_BBY, k] = ser[at.S_S1Y, k] - product(ser, at.S_S0, at.S_XIY, k)
        cross = product(ser, at.S_XIX, at.S_S1X, k) + product(ser, at.S_XIY, at.S_S1Y, k)
        cross += product(ser, at.S_XIX, at.S_BBX, k) + product(ser, at.S_XIY, at.S_BBY, k)
        ser[at.S_CC, k] = ser[at.S_C2, k] - cross
        ax = kappa * (
            ser[at.S_DX, k] - product(ser, at.S_S0, at.S_UX, k) + product(ser, at.S_OM, at.S_BBY, k)
        )
        ay = kappa * (
            ser[at.S_DY, k] - product(ser, at.S_S0, at.S_UY, k) - product(ser, at.S_OM, at.S_BBX, k)
        )
        torque -= product(ser, at.S_BBX, at.S_UY, k) - product(ser, at.S_BBY, at.S_UX, k)
    torque -= product(ser, at.S_OM, at.S_CC, k)
    return ax, ay, kappa * par[at.MASS_OVER_INERTIA] * torque


@kernel
def angle_terms(ser, k):
    """Coefficient k + 1 of cosine, sine and of ``E1``, ``E2`` (k + 1 >= 1; ``Y`` starts at 0)."""
    cosine, sine = 0.0, 0.0
    for j in range(k + 1):
        turn = ser[at.S_OM, k - j]
        cosine -= ser[at.S_S, j] * turn
        sine += ser[at.S_C, j] * turn
    ser[at.S_C, k + 1] = cosine / (k + 1)
    ser[at.S_S, k + 1] = sine / (k + 1)
    cx = sy = cy = sx = 0.0
    for j in range(k + 1):
        x, y = ser[at.S_X, k + 1 - j], ser[at.S_Y, k + 1 - j]
        c, s = ser[at.S_C, j], ser[at.S_S, j]
        cx += c * x
        sy += s * y
        cy += c * y
        sx += s * x
    ser[at.S_E1, k + 1] = cx + sy
    ser[at.S_E2, k + 1] = cy - sx


@kernel
def hold_surfaces(grp, groups, ser, k, ax, ay, al, matrix, reply, f, scratch):
    """Loads of captured groups at order k that keep each surface's second rate at zero to that order.

    ``ax, ay, al`` are the accelerations with no load on the groups at this order. Returns them corrected.
    """
    up = (k + 1) * (k + 2)
    ser[at.S_X, k + 1], ser[at.S_Y, k + 1] = ser[at.S_UX, k] / (k + 1), ser[at.S_UY, k] / (k + 1)
    angle_terms(ser, k)
    ser[at.S_X, k + 2], ser[at.S_Y, k + 2] = ax / up, ay / up
    ser[at.S_OM, k + 1] = al / (k + 1)
    angle_terms(ser, k + 1)
    for g in range(groups):
        second = grp[g, at.A_C] * ser[at.S_C, k + 2] + grp[g, at.A_S] * ser[at.S_S, k + 2]
        second += grp[g, at.A_1] * ser[at.S_E1, k + 2] + grp[g, at.A_2] * ser[at.S_E2, k + 2]
        reply[3, g] = -second * up
    solve(matrix, groups, reply[3], f, scratch)
    for h in range(groups):
        ser[at.S_F + h, k] = f[h]
        ax += f[h] * reply[0, h]
        ay += f[h] * reply[1, h]
        al += f[h] * reply[2, h]
    return ax, ay, al


@kernel
def start(seg, groups, y, e, c, s, f, ser):
    """Order 0 of every series."""
    ser[at.S_X, 0] = ser[at.S_Y, 0] = ser[at.S_TH, 0] = ser[at.S_E1, 0] = ser[at.S_E2, 0] = 0.0
    ser[at.S_UX, 0], ser[at.S_UY, 0], ser[at.S_OM, 0] = y[at.UX], y[at.UY], y[at.OMEGA]
    ser[at.S_C, 0], ser[at.S_S, 0] = c, s
    ser[at.S_XIX, 0], ser[at.S_XIY, 0] = -seg[at.CX], -seg[at.CY]
    ser[at.S_EXP, 0] = e
    for h in range(groups):
        ser[at.S_F + h, 0] = f[h]


@kernel
def taylor(seg, grp, ctl, y, par, e, c, s, tmax, matrix, reply, f, scratch, ser):
    """Coefficients of the motion from now, to the order that ``tmax`` or the tolerance asks.

    Returns (order, step): the order of the position series, and how far, up to ``tmax``, it holds.
    """
    groups, rate = ctl[at.N_GROUPS], par[at.RATE]
    motors = rate > 0.0 and e != 0.0
    start(seg, groups, y, e, c, s, f, ser)
    radius, memory = par[at.RADIUS], par[at.MEMORY]
    share = min(1.0, tmax / memory)
    wanted = max(par[at.TOLERANCE] * 1e-3 * max(share, 1e-2), 1e-18)
    power, before = 1.0, 1e300
    order, last, previous = at.MAX_ORDER, 0.0, 0.0
    for k in range(at.MAX_ORDER):
        for h in range(groups):
            if k > 0:
                ser[at.S_F + h, k] = 0.0
        load_plane(seg, grp, groups, ser, k)
        linear_terms(seg, grp, groups, motors, ser, k)
        ax, ay, al = acceleration_terms(seg, par, ser, k)
        if groups > 0 and k > 0:
            ax, ay, al = hold_surfaces(grp, groups, ser, k, ax, ay, al, matrix, reply, f, scratch)
            load_plane(seg, grp, groups, ser, k)
            linear_terms(seg, grp, groups, motors, ser, k)
        n = k + 1
        ser[at.S_X, n], ser[at.S_Y, n], ser[at.S_TH, n] = (
            ser[at.S_UX, k] / n,
            ser[at.S_UY, k] / n,
            ser[at.S_OM, k] / n,
        )
        ser[at.S_UX, n], ser[at.S_UY, n], ser[at.S_OM, n] = ax / n, ay / n, al / n
        ser[at.S_XIX, n], ser[at.S_XIY, n] = ser[at.S_X, n], ser[at.S_Y, n]
        ser[at.S_EXP, n] = -rate * ser[at.S_EXP, k] / n
        angle_terms(ser, k)
        size = max(abs(ser[at.S_X, n]), abs(ser[at.S_Y, n]), radius * abs(ser[at.S_TH, n]))
        # a parcel that turns steadily has a short angle series, but events are read from sine and cosine
        size = max(size, radius * abs(ser[at.S_C, n]), radius * abs(ser[at.S_S, n]))
        size = max(size, abs(ser[at.S_E1, n]), abs(ser[at.S_E2, n]))
        size += memory * max(abs(ser[at.S_UX, n]), abs(ser[at.S_UY, n]), radius * abs(ser[at.S_OM, n]))
        power *= tmax
        previous, last = last, size
        if n >= 3 and size * power <= wanted and before <= wanted:
            order = n
            break
        before = size * power
    for h in range(groups):
        ser[at.S_F + h, order] = 0.0
    load_plane(seg, grp, groups, ser, order)
    if order < at.MAX_ORDER or before <= wanted:
        return order, tmax
    step = tmax
    wanted = max(par[at.TOLERANCE] * 1e-3, 1e-18)
    if last > 0.0:
        step = min(step, (wanted / last) ** (1.0 / order))
    if previous > 0.0:
        step = min(step, (wanted / previous) ** (1.0 / (order - 1)))
    return order, step
