"""One Taylor step: coefficients of the motion to the order that the step needs, and the step's length.

Between events every quantity is a product of series (``dynamics``: translation linear, rotation linear with
polynomial coefficients, footprint through sine and cosine of the angle), so each coefficient follows from lower ones
by Cauchy products. Loads of captured cells are series too, fixed order by order by the surfaces' second rates.
"""

from __future__ import annotations

from plant.kernels.jit import kernel
from plant.kernels.layout import (
    A_1,
    A_2,
    A_C,
    A_S,
    CX,
    CY,
    DECAY,
    DRIVEN,
    G0,
    G1X,
    G1Y,
    K0X,
    K0Y,
    K1XX,
    K1XY,
    K1YX,
    K1YY,
    KAPPA,
    MASS_OVER_INERTIA,
    MAX_ORDER,
    MEMORY,
    N_ACTIVE,
    N_GROUPS,
    OMEGA,
    PXX,
    PXY,
    PYY,
    RADIUS,
    RATE,
    S_A0,
    S_BBX,
    S_BBY,
    S_BX,
    S_BX_,
    S_BY,
    S_BY_,
    S_C,
    S_C2,
    S_CC,
    S_DBX,
    S_DBY,
    S_DX,
    S_DY,
    S_E1,
    S_E2,
    S_EXP,
    S_F,
    S_OM,
    S_RB,
    S_RV,
    S_RX,
    S_RY,
    S_S,
    S_S0,
    S_S1X,
    S_S1Y,
    S_T,
    S_TB,
    S_TH,
    S_UX,
    S_UY,
    S_VX,
    S_VY,
    S_W,
    S_WRR,
    S_WRX,
    S_WRY,
    S_X,
    S_XIX,
    S_XIY,
    S_Y,
    STEADY,
    T0,
    T1X,
    T1Y,
    TOLERANCE,
    UX,
    UY,
    W0,
    W1X,
    W1Y,
    W2XX,
    W2XY,
    W2YY,
)  # fmt: skip
from plant.kernels.motion import solve


@kernel
def product(ser, a, b, k):
    """Coefficient k of the product of two series."""
    total = 0.0
    for j in range(k + 1):
        total += ser[a, j] * ser[b, k - j]
    return total


@kernel
def linear_terms(seg, grp, groups, motors, ser, k):
    """Coefficient k of everything linear in the loads: D, T and, where wheels coast, S0, S1; and C2."""
    a0, bx, by = ser[S_A0, k], ser[S_BX_, k], ser[S_BY_, k]
    s = STEADY
    ser[S_DX, k] = a0 * seg[s + K0X] + bx * seg[s + K1XX] + by * seg[s + K1XY]
    ser[S_DY, k] = a0 * seg[s + K0Y] + bx * seg[s + K1YX] + by * seg[s + K1YY]
    ser[S_T, k] = a0 * seg[s + T0] + bx * seg[s + T1X] + by * seg[s + T1Y]
    ser[S_S0, k] = a0 * seg[W0] + bx * seg[W1X] + by * seg[W1Y]
    ser[S_S1X, k] = a0 * seg[W1X] + bx * seg[W2XX] + by * seg[W2XY]
    ser[S_S1Y, k] = a0 * seg[W1Y] + bx * seg[W2XY] + by * seg[W2YY]
    ser[S_C2, k] = a0 * seg[G0] + bx * seg[G1X] + by * seg[G1Y]
    for h in range(groups):
        f = ser[S_F + h, k]
        ser[S_DX, k] += f * grp[h, S_VX]
        ser[S_DY, k] += f * grp[h, S_VY]
        ser[S_T, k] += f * grp[h, S_RV]
        ser[S_S0, k] += f * grp[h, S_W]
        ser[S_S1X, k] += f * grp[h, S_WRX]
        ser[S_S1Y, k] += f * grp[h, S_WRY]
        ser[S_C2, k] += f * grp[h, S_WRR]
    if motors:
        d = DECAY
        ser[S_DBX, k] = a0 * seg[d + K0X] + bx * seg[d + K1XX] + by * seg[d + K1XY]
        ser[S_DBY, k] = a0 * seg[d + K0Y] + bx * seg[d + K1YX] + by * seg[d + K1YY]
        ser[S_TB, k] = a0 * seg[d + T0] + bx * seg[d + T1X] + by * seg[d + T1Y]
        for h in range(groups):
            f = ser[S_F + h, k]
            ser[S_DBX, k] += f * grp[h, S_BX]
            ser[S_DBY, k] += f * grp[h, S_BY]
            ser[S_TB, k] += f * grp[h, S_RB]
        ser[S_DX, k] += product(ser, S_EXP, S_DBX, k)
        ser[S_DY, k] += product(ser, S_EXP, S_DBY, k)
        ser[S_T, k] += product(ser, S_EXP, S_TB, k)


@kernel
def load_plane(seg, grp, groups, ser, k):
    """Coefficient k of the plane ``a0 + b . r`` of the active supports' loads."""
    mx, my = ser[S_XIX, k], ser[S_XIY, k]
    total = 1.0 if k == 0 else 0.0
    for h in range(groups):
        f = ser[S_F + h, k]
        total -= f
        mx -= f * grp[h, S_RX]
        my -= f * grp[h, S_RY]
    ser[S_A0, k] = total / seg[N_ACTIVE]
    ser[S_BX_, k] = seg[PXX] * mx + seg[PXY] * my
    ser[S_BY_, k] = seg[PXY] * mx + seg[PYY] * my


@kernel
def acceleration_terms(seg, par, ser, k):
    """Coefficient k of (ax, ay, alpha)."""
    kappa = par[KAPPA]
    torque = ser[S_T, k] - product(ser, S_XIX, S_DY, k) + product(ser, S_XIY, S_DX, k)
    square = product(ser, S_XIX, S_XIX, k) + product(ser, S_XIY, S_XIY, k)
    if seg[DRIVEN] == 1.0:
        ser[S_CC, k] = ser[S_C2, k] - square
        ax = kappa * (ser[S_DX, k] - ser[S_UX, k])
        ay = kappa * (ser[S_DY, k] - ser[S_UY, k])
    else:
        # coasting wheels carry load but pull nothing: resistance no longer acts at the centre of mass
        ser[S_BBX, k] = ser[S_S1X, k] - product(ser, S_S0, S_XIX, k)
        ser[S_BBY, k] = ser[S_S1Y, k] - product(ser, S_S0, S_XIY, k)
        cross = product(ser, S_XIX, S_S1X, k) + product(ser, S_XIY, S_S1Y, k)
        cross += product(ser, S_XIX, S_BBX, k) + product(ser, S_XIY, S_BBY, k)
        ser[S_CC, k] = ser[S_C2, k] - cross
        ax = kappa * (ser[S_DX, k] - product(ser, S_S0, S_UX, k) + product(ser, S_OM, S_BBY, k))
        ay = kappa * (ser[S_DY, k] - product(ser, S_S0, S_UY, k) - product(ser, S_OM, S_BBX, k))
        torque -= product(ser, S_BBX, S_UY, k) - product(ser, S_BBY, S_UX, k)
    torque -= product(ser, S_OM, S_CC, k)
    return ax, ay, kappa * par[MASS_OVER_INERTIA] * torque


@kernel
def angle_terms(ser, k):
    """Coefficient k + 1 of cosine, sine and of ``E1``, ``E2`` (k + 1 >= 1; ``Y`` starts at 0)."""
    ser[S_C, k + 1] = -product(ser, S_S, S_OM, k) / (k + 1)
    ser[S_S, k + 1] = product(ser, S_C, S_OM, k) / (k + 1)
    ser[S_E1, k + 1] = product(ser, S_C, S_X, k + 1) + product(ser, S_S, S_Y, k + 1)
    ser[S_E2, k + 1] = product(ser, S_C, S_Y, k + 1) - product(ser, S_S, S_X, k + 1)


@kernel
def hold_surfaces(grp, groups, ser, k, ax, ay, al, matrix, reply, f, scratch):
    """Loads of captured groups at order k that keep each surface's second rate at zero to that order.

    ``ax, ay, al`` are the accelerations with no load on the groups at this order. Returns them corrected.
    """
    up = (k + 1) * (k + 2)
    ser[S_X, k + 1], ser[S_Y, k + 1] = ser[S_UX, k] / (k + 1), ser[S_UY, k] / (k + 1)
    angle_terms(ser, k)
    ser[S_X, k + 2], ser[S_Y, k + 2] = ax / up, ay / up
    ser[S_OM, k + 1] = al / (k + 1)
    angle_terms(ser, k + 1)
    for g in range(groups):
        second = grp[g, A_C] * ser[S_C, k + 2] + grp[g, A_S] * ser[S_S, k + 2]
        second += grp[g, A_1] * ser[S_E1, k + 2] + grp[g, A_2] * ser[S_E2, k + 2]
        reply[g, 3] = -second * up
    solve(matrix, groups, reply[:, 3], f, scratch)
    for h in range(groups):
        ser[S_F + h, k] = f[h]
        ax += f[h] * reply[h, 0]
        ay += f[h] * reply[h, 1]
        al += f[h] * reply[h, 2]
    return ax, ay, al


@kernel
def start(seg, grp, groups, y, e, c, s, f, ser):
    """Order 0 of every series."""
    ser[S_X, 0] = ser[S_Y, 0] = ser[S_TH, 0] = ser[S_E1, 0] = ser[S_E2, 0] = 0.0
    ser[S_UX, 0], ser[S_UY, 0], ser[S_OM, 0] = y[UX], y[UY], y[OMEGA]
    ser[S_C, 0], ser[S_S, 0] = c, s
    ser[S_XIX, 0], ser[S_XIY, 0] = -seg[CX], -seg[CY]
    ser[S_EXP, 0] = e
    for h in range(groups):
        ser[S_F + h, 0] = f[h]


@kernel
def taylor(seg, grp, ctl, y, par, e, c, s, tmax, matrix, reply, f, scratch, ser):
    """Coefficients of the motion from now, to the order that ``tmax`` or the tolerance asks.

    Returns (order, step): the order of the position series, and how far, up to ``tmax``, it holds.
    """
    groups, rate = ctl[N_GROUPS], par[RATE]
    motors = rate > 0.0 and e != 0.0
    start(seg, grp, groups, y, e, c, s, f, ser)
    radius, memory = par[RADIUS], par[MEMORY]
    share = min(1.0, tmax / memory)
    wanted = max(par[TOLERANCE] * 1e-3 * max(share, 1e-2), 1e-18)
    power, before = 1.0, 1e300
    order, last, previous = MAX_ORDER, 0.0, 0.0
    for k in range(MAX_ORDER):
        for h in range(groups):
            if k > 0:
                ser[S_F + h, k] = 0.0
        load_plane(seg, grp, groups, ser, k)
        linear_terms(seg, grp, groups, motors, ser, k)
        ax, ay, al = acceleration_terms(seg, par, ser, k)
        if groups > 0 and k > 0:
            ax, ay, al = hold_surfaces(grp, groups, ser, k, ax, ay, al, matrix, reply, f, scratch)
            load_plane(seg, grp, groups, ser, k)
            linear_terms(seg, grp, groups, motors, ser, k)
        n = k + 1
        ser[S_X, n], ser[S_Y, n], ser[S_TH, n] = ser[S_UX, k] / n, ser[S_UY, k] / n, ser[S_OM, k] / n
        ser[S_UX, n], ser[S_UY, n], ser[S_OM, n] = ax / n, ay / n, al / n
        ser[S_XIX, n], ser[S_XIY, n] = ser[S_X, n], ser[S_Y, n]
        ser[S_EXP, n] = -rate * ser[S_EXP, k] / n
        angle_terms(ser, k)
        size = max(abs(ser[S_X, n]), abs(ser[S_Y, n]), radius * abs(ser[S_TH, n]))
        size += memory * max(abs(ser[S_UX, n]), abs(ser[S_UY, n]), radius * abs(ser[S_OM, n]))
        power *= tmax
        previous, last = last, size
        if n >= 3 and size * power <= wanted and before <= wanted:
            order = n
            break
        before = size * power
    for h in range(groups):
        ser[S_F + h, order] = 0.0
    load_plane(seg, grp, groups, ser, order)
    if order < MAX_ORDER or before <= wanted:
        return order, tmax
    step = tmax
    wanted = max(par[TOLERANCE] * 1e-3, 1e-18)
    if last > 0.0:
        step = min(step, (wanted / last) ** (1.0 / order))
    if previous > 0.0:
        step = min(step, (wanted / previous) ** (1.0 / (order - 1)))
    return order, step
