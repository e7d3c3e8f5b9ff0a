"""One Taylor step: coefficients of the motion to the order that the step needs, and the step's length.

Between events every quantity is a product of series (``dynamics``: translation linear, rotation linear with
polynomial coefficients, footprint through sine and cosine of the angle), so each coefficient follows from lower ones
by Cauchy products. Where chatter is captured, the fractions in which modes mix are series too, fixed order by
order by the surfaces' second rates.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.motion import differences, linear, solve


@kernel
def product(ser, a, b, k):
    """Coefficient k of the product of two series."""
    total = 0.0
    for j in range(k + 1):
        total += ser[a, j] * ser[b, k - j]
    return total


@kernel
def linear_terms(seg, motors, ser, o, k):
    """Coefficient k of a mode's springs' plane ``a0 + b . r`` and of all that is linear in it.

    That is D, T, C2 and, unless wheels resist in proportion to their loads alone, S0 and S1.

    ``o`` is the first row of the mode in ``ser``.
    """
    mx, my = ser[o + at.M_XIX, k], ser[o + at.M_XIY, k]
    a0 = 1.0 / seg[at.N_ACTIVE] if k == 0 else 0.0
    bx, by = seg[at.PXX] * mx + seg[at.PXY] * my, seg[at.PXY] * mx + seg[at.PYY] * my
    ser[o + at.M_A0, k], ser[o + at.M_BX, k], ser[o + at.M_BY, k] = a0, bx, by
    s = at.STEADY
    ser[o + at.M_DX, k] = linear(seg, s + at.DX, a0, bx, by)
    ser[o + at.M_DY, k] = linear(seg, s + at.DY, a0, bx, by)
    ser[o + at.M_T, k] = linear(seg, s + at.T, a0, bx, by)
    if seg[at.UNIFORM] == 0.0:
        ser[o + at.M_S0X, k] = linear(seg, at.S0X, a0, bx, by)
        ser[o + at.M_S0Y, k] = linear(seg, at.S0Y, a0, bx, by)
        ser[o + at.M_S1X, k] = linear(seg, at.S1X, a0, bx, by)
        ser[o + at.M_S1Y, k] = linear(seg, at.S1Y, a0, bx, by)
    ser[o + at.M_C2, k] = linear(seg, at.C2, a0, bx, by)
    if motors:
        d = at.DECAY
        ser[o + at.M_DBX, k] = linear(seg, d + at.DX, a0, bx, by)
        ser[o + at.M_DBY, k] = linear(seg, d + at.DY, a0, bx, by)
        ser[o + at.M_TB, k] = linear(seg, d + at.T, a0, bx, by)
        ser[o + at.M_DX, k] += product(ser, at.S_EXP, o + at.M_DBX, k)
        ser[o + at.M_DY, k] += product(ser, at.S_EXP, o + at.M_DBY, k)
        ser[o + at.M_T, k] += product(ser, at.S_EXP, o + at.M_TB, k)


@kernel
def acceleration_terms(seg, par, ser, o, k):
    """Coefficient k of a mode's (ax, ay, alpha)."""
    kappa = par[at.KAPPA]
    moment_x = moment_y = xx = yy = 0.0
    for j in range(k + 1):
        x, y = ser[o + at.M_XIX, j], ser[o + at.M_XIY, j]
        moment_x += x * ser[o + at.M_DY, k - j]
        moment_y += y * ser[o + at.M_DX, k - j]
        xx += x * ser[o + at.M_XIX, k - j]
        yy += y * ser[o + at.M_XIY, k - j]
    torque = ser[o + at.M_T, k] - moment_x + moment_y
    square = xx + yy
    if seg[at.UNIFORM] == 1.0:
        ser[o + at.M_CC, k] = ser[o + at.M_C2, k] - square
        ax = kappa * (ser[o + at.M_DX, k] - ser[at.S_UX, k])
        ay = kappa * (ser[o + at.M_DY, k] - ser[at.S_UY, k])
    else:
        # resistance that isn't spread as the loads are does not act at the centre of mass
        xix, xiy, s0x, s0y, s1x, s1y = (
            o + at.M_XIX,
            o + at.M_XIY,
            o + at.M_S0X,
            o + at.M_S0Y,
            o + at.M_S1X,
            o + at.M_S1Y,
        )
        qx, qy = o + at.M_QX, o + at.M_QY
        ser[qx, k] = ser[s1x, k] - product(ser, s0x, xiy, k)
        ser[qy, k] = ser[s1y, k] - product(ser, s0y, xix, k)
        cross = product(ser, xix, s1y, k) + product(ser, xiy, s1x, k)
        cross += product(ser, xix, qy, k) + product(ser, xiy, qx, k)
        ser[o + at.M_CC, k] = ser[o + at.M_C2, k] - cross
        pull_x = product(ser, s0x, at.S_UX, k) - product(ser, at.S_OM, qx, k)
        pull_y = product(ser, s0y, at.S_UY, k) + product(ser, at.S_OM, qy, k)
        ax = kappa * (ser[o + at.M_DX, k] - pull_x)
        ay = kappa * (ser[o + at.M_DY, k] - pull_y)
        torque -= product(ser, qy, at.S_UY, k) - product(ser, qx, at.S_UX, k)
    torque -= product(ser, at.S_OM, o + at.M_CC, k)
    al = kappa * par[at.MASS_OVER_INERTIA] * torque
    ser[o + at.M_AX, k], ser[o + at.M_AY, k], ser[o + at.M_AL, k] = ax, ay, al
    return ax, ay, al


@kernel
def shares(ser, groups, k):
    """Coefficient k of the products of fractions, from those of the fractions themselves."""
    for m in range(1 << groups):
        rest = m & (m - 1)
        if rest != 0:
            ser[at.S_SHARE + m, k] = product(ser, at.S_SHARE + (m ^ rest), at.S_SHARE + rest, k)


@kernel
def clear_shares(ser, groups, k):
    """Coefficient k of the shares while that of the fractions is zero."""
    ser[at.S_SHARE, k] = 0.0
    for h in range(groups):
        ser[at.S_SHARE + (1 << h), k] = 0.0
    shares(ser, groups, k)


@kernel
def mix(ser, groups, adds, k):
    """Coefficient k of the modes' mixed acceleration; ``adds`` is work space.

    The modes' rows become what sets of groups add (``motion.differences``).
    """
    for m in range(1 << groups):
        o = at.MODES_AT + m * at.MODE_ROWS
        adds[m, 0], adds[m, 1], adds[m, 2] = ser[o + at.M_AX, k], ser[o + at.M_AY, k], ser[o + at.M_AL, k]
    differences(adds, groups)
    ax = ay = al = 0.0
    for m in range(1 << groups):
        o, share = at.MODES_AT + m * at.MODE_ROWS, at.S_SHARE + m
        ser[o + at.M_AX, k], ser[o + at.M_AY, k], ser[o + at.M_AL, k] = adds[m, 0], adds[m, 1], adds[m, 2]
        ax += product(ser, share, o + at.M_AX, k)
        ay += product(ser, share, o + at.M_AY, k)
        al += product(ser, share, o + at.M_AL, k)
    return ax, ay, al


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
def hold_surfaces(work, groups, k, ax, ay, al):
    """Fractions at order k that keep each surface's second rate at zero to that order.

    ``ax, ay, al`` are the accelerations with no fraction of this order. Returns them corrected.
    """
    ser, grp, reply, change = work.ser, work.grp, work.reply, work.change
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
    solve(work.matrix, groups, reply[3], change, work.scratch)
    for h in range(groups):
        ser[at.S_SHARE + (1 << h), k] = change[h]
        ax += change[h] * reply[0, h]
        ay += change[h] * reply[1, h]
        al += change[h] * reply[2, h]
    shares(ser, groups, k)
    return ax, ay, al


@kernel
def mixed(work, groups, k):
    """Coefficient k of the acceleration along captured surfaces, from that of every mode."""
    if k == 0:
        return mix(work.ser, groups, work.adds, k)
    clear_shares(work.ser, groups, k)
    ax, ay, al = mix(work.ser, groups, work.adds, k)
    return hold_surfaces(work, groups, k, ax, ay, al)


@kernel
def start(segs, groups, y, e, c, s, fraction, ser):
    """Order 0 of every series."""
    ser[at.S_X, 0] = ser[at.S_Y, 0] = ser[at.S_TH, 0] = ser[at.S_E1, 0] = ser[at.S_E2, 0] = 0.0
    ser[at.S_UX, 0], ser[at.S_UY, 0], ser[at.S_OM, 0] = y[at.UX], y[at.UY], y[at.OMEGA]
    ser[at.S_C, 0], ser[at.S_S, 0] = c, s
    ser[at.S_EXP, 0] = e
    for m in range(1 << groups):
        o = at.MODES_AT + m * at.MODE_ROWS
        ser[o + at.M_XIX, 0], ser[o + at.M_XIY, 0] = -segs[m, at.CX], -segs[m, at.CY]
    ser[at.S_SHARE, 0] = 1.0
    for h in range(groups):
        ser[at.S_SHARE + (1 << h), 0] = fraction[h]
    shares(ser, groups, at.ZERO)


@kernel
def taylor(parcel, work, e, c, s, tmax):
    """Coefficients of the motion from now into ``work.ser``, to the order that ``tmax`` or the tolerance asks.

    Returns (order, step): the order of the position series, and how far, up to ``tmax``, it holds.
    """
    par, ser, segs = parcel.par, work.ser, work.segs
    groups, rate = parcel.ctl[at.N_GROUPS], par[at.RATE]
    motors = rate > 0.0 and e != 0.0
    start(segs, groups, parcel.y, e, c, s, work.fraction, ser)
    radius, memory = par[at.RADIUS], par[at.MEMORY]
    share = min(1.0, tmax / memory)
    wanted = max(par[at.TOLERANCE] * 1e-3 * max(share, 1e-2), 1e-18)
    power, before = 1.0, 1e300
    order, last, previous = at.MAX_ORDER, 0.0, 0.0
    for k in range(at.MAX_ORDER):
        for m in range(1 << groups):
            o = at.MODES_AT + m * at.MODE_ROWS
            linear_terms(segs[m], motors, ser, o, k)
            ax, ay, al = acceleration_terms(segs[m], par, ser, o, k)
        if groups > 0:
            ax, ay, al = mixed(work, groups, k)
        n = k + 1
        ser[at.S_X, n], ser[at.S_Y, n], ser[at.S_TH, n] = (
            ser[at.S_UX, k] / n,
            ser[at.S_UY, k] / n,
            ser[at.S_OM, k] / n,
        )
        ser[at.S_UX, n], ser[at.S_UY, n], ser[at.S_OM, n] = ax / n, ay / n, al / n
        for m in range(1 << groups):
            o = at.MODES_AT + m * at.MODE_ROWS
            ser[o + at.M_XIX, n], ser[o + at.M_XIY, n] = ser[at.S_X, n], ser[at.S_Y, n]
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
    clear_shares(ser, groups, order)
    for m in range(1 << groups):
        linear_terms(segs[m], motors, ser, at.MODES_AT + m * at.MODE_ROWS, order)
    if order < at.MAX_ORDER or before <= wanted:
        return order, tmax
    step = tmax
    wanted = max(par[at.TOLERANCE] * 1e-3, 1e-18)
    if last > 0.0:
        step = min(step, (wanted / last) ** (1.0 / order))
    if previous > 0.0:
        step = min(step, (wanted / previous) ** (1.0 / (order - 1)))
    return order, step
