"""The motion all along a step that was taken, as the series that events are searched in.

Velocity is the cubic of Hermite through both ends of the step with their accelerations, plus the quartic that makes its
integral the displacement: together the quintic of Hermite for the position. A velocity that stays the same to the bit,
as that of a parcel that sticks does, is read from it to the bit. All series are in unit time.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.branches import lever, pulls
from plant.kernels.implicit.balance_hooks import balance, begin_balance, hold_supports
from plant.kernels.implicit.extrapolation import euler
from plant.kernels.implicit.hooks import note_lags, own_rates
from plant.kernels.implicit.step import EPSILON, INSTANT, grasp, press, pull, slips_jump, unlimited
from plant.kernels.implicit.stiction_hooks import find_velocity
from plant.kernels.implicit.supports import decay

DEGREE = 5
"""Of a position."""
ROUNDING = 32.0
"""A displacement is wrong by so many roundings of the places at its ends: the weights of the extrapolation add up."""
SMALLEST = 1e-17
"""Terms of sine and cosine below this, in metres at the footprint, are left out, ..."""
SMALLEST_DECAY = 1e-16
"""... and terms of the motors' transient below this share."""


@kernel
def to_rates(surface, parcel, work, e):
    """Turn the wheels listed into those of the problem whose unknowns are accelerations.

    Slips become rates of slip, and what depends on the velocity alone is a given force.
    """
    y, par, row = parcel.y, parcel.par, at.ZERO
    fade = -par[at.RATE] * e * par[at.FREE_SPEED]
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = parcel.mem[i, at.CELL]
        if not pulls(surface, parcel, i):
            continue
        wheel = work.wheels[row]
        for axis in range(2):
            along = y[at.UX + axis] + lever(surface, y, cell, axis) * y[at.OMEGA]
            wheel[im.OWN_X + axis] = wheel[im.GX + axis] - wheel[im.OWN_K] * along
            wheel[im.GX + axis] -= wheel[im.K] * along
        wheel[im.K] = 0.0
        # the levers change as the centre of mass moves
        wheel[im.SX] = fade * surface.decay[cell, 0] - y[at.OMEGA] * y[at.UY]
        wheel[im.SY] = fade * surface.decay[cell, 1] + y[at.OMEGA] * y[at.UX]
        wheel[im.SUMMED] = abs(fade) * (abs(surface.decay[cell, 0]) + abs(surface.decay[cell, 1]))
        wheel[im.SUMMED] += abs(y[at.OMEGA]) * (abs(y[at.UX]) + abs(y[at.UY]))
        own_rates(work, parcel, row, wheel)
        row += 1


@kernel
def by_rule(surface, parcel, work, now):
    """Acceleration where wheels stick or slip as their branches say, into ``work.velocity``, by Gauss's principle.

    Of all forces within the limits those act that leave the least rates of slip: a step's problem, of one second from
    rest, in accelerations. ``work.wheels`` has the rates of slip.
    """
    e, start = decay(parcel.par, now), work.start
    count = grasp(surface, parcel, work, work.law, e, at.NOTHING)
    to_rates(surface, parcel, work, e)
    start[0] = start[1] = start[2] = 0.0
    find_velocity(surface, parcel, work, count, im.UNITY, work.velocity)
    note_lags(work, parcel, count)


@kernel
def by_formula(surface, parcel, work, now):
    """Acceleration, into ``work.velocity``, by forces that follow from the slips."""
    y, w, arm, law = parcel.y, work.velocity, work.pace[im.GYRATION], work.law
    w[0], w[1], w[2] = y[at.UX], y[at.UY], arm * y[at.OMEGA]
    count = grasp(surface, parcel, work, law, decay(parcel.par, now), at.NOTHING)
    along_x = along_y = turn = 0.0
    for i in range(count):
        row = work.wheels[i]
        fx, fy, _, _, _ = pull(row, w, law[im.ISOTROPIC])
        gx, gy = unlimited(row, w)
        fx, fy = fx + gx, fy + gy
        along_x += fx
        along_y += fy
        turn += row[im.AX] * fx + row[im.AY] * fy
    w[0], w[1], w[2] = along_x, along_y, turn


@kernel
def over_an_instant(law):
    """Whether forces have no formula: wheels that push by the way in which they run may be brought to a stand."""
    return law[im.WHEEL] != 0.0 and law[im.PUSH_PER_SHARE] != 0.0


@kernel
def accelerate(surface, parcel, work, now, acceleration):
    """Acceleration where the parcel is, at ``now``, with the supports of the step, into ``acceleration[:3]``.

    By a step of an instant where a force has no formula. Returns the status:
    TIPPED where no loads balance the traction.
    """
    y, w, law = parcel.y, work.velocity, work.law
    hold_supports(surface, parcel, work, at.NOTHING)
    ruled = slips_jump(law)
    if over_an_instant(law):
        for k in range(6):
            work.state[k] = y[k]
        status, _, _ = euler(surface, parcel, work, now + INSTANT, INSTANT)
        for k in range(3):
            acceleration[k] = (y[at.UX + k] - work.state[at.UX + k]) / INSTANT
        for k in range(6):
            y[k] = work.state[k]
        hold_supports(surface, parcel, work, at.NOTHING)
        return status
    begin_balance(surface)
    instant = decay(parcel.par, now), at.NOTHING, y[at.UX], y[at.UY], work.pace[im.GYRATION] * y[at.OMEGA]
    while True:
        if ruled:
            by_rule(surface, parcel, work, now)
        else:
            by_formula(surface, parcel, work, now)
        noise = 8.0 * EPSILON * (abs(w[0]) + abs(w[1]))
        status = balance(surface, parcel, work, instant, w[0], w[1], noise)
        if status != im.UNBALANCED:
            break
    acceleration[0], acceleration[1], acceleration[2] = w[0], w[1], w[2] / work.pace[im.GYRATION]
    return status


@kernel
def hermite(position, velocity, ends, accelerations, h):
    """Series of one coordinate and of its velocity; ``ends`` is (q0, u0, q1, u1), ``accelerations`` (a0, a1)."""
    q0, u0, q1, u1 = ends
    a0, a1 = h * accelerations[0], h * accelerations[1]
    change = u1 - u0
    velocity[0], velocity[1] = u0, a0
    velocity[2], velocity[3] = 3.0 * change - 2.0 * a0 - a1, a0 + a1 - 2.0 * change
    missing = (q1 - q0) - h * (u0 + 0.5 * change + (a0 - a1) / 12.0)
    if abs(missing) <= ROUNDING * EPSILON * (abs(q0) + abs(q1) + h * abs(u0)):
        missing = 0.0
    bump = 30.0 * missing / h
    velocity[2] += bump
    velocity[3] -= 2.0 * bump
    velocity[4] = bump
    position[0] = 0.0
    for k in range(DEGREE):
        position[k + 1] = h * velocity[k] / (k + 1)


@kernel
def turn_terms(ser, k):
    """Coefficient k + 1 of cosine and sine, from the angle's."""
    cosine, sine = 0.0, 0.0
    for j in range(max(0, k + 1 - DEGREE), k + 1):
        turn = (k + 1 - j) * ser[at.S_TH, k + 1 - j]
        cosine -= ser[at.S_S, j] * turn
        sine += ser[at.S_C, j] * turn
    ser[at.S_C, k + 1], ser[at.S_S, k + 1] = cosine / (k + 1), sine / (k + 1)


@kernel
def place_terms(ser, k):
    """Coefficient k of the displacement in the parcel's axes, from displacement, cosine and sine."""
    cx = sy = cy = sx = 0.0
    for j in range(1, min(k, DEGREE) + 1):
        x, y, c, s = ser[at.S_X, j], ser[at.S_Y, j], ser[at.S_C, k - j], ser[at.S_S, k - j]
        cx += c * x
        sy += s * y
        cy += c * y
        sx += s * x
    ser[at.S_E1, k], ser[at.S_E2, k] = cx + sy, cy - sx


@kernel
def expand_planes(surface, parcel, work, order):
    """Series of every mode's plane of the springs; a fraction's end is looked for elsewhere."""
    ser, groups = work.ser, parcel.ctl[at.N_GROUPS]
    press(surface, parcel, work, 0.0, 0.0)
    for m in range(1 << groups):
        seg, o = work.segs[m], at.MODES_AT + m * at.MODE_ROWS
        for k in range(order + 1):
            x, y = ser[at.S_X, k], ser[at.S_Y, k]
            ser[o + at.M_A0, k] = 0.0
            ser[o + at.M_BX, k] = seg[at.PXX] * x + seg[at.PXY] * y
            ser[o + at.M_BY, k] = seg[at.PXY] * x + seg[at.PYY] * y
        for k in range(3):
            ser[o + at.M_A0 + k, 0] = work.planes[m, k]
    for h in range(groups):
        for k in range(order + 1):
            ser[at.S_SHARE + (1 << h), k] = 0.0
        ser[at.S_SHARE + (1 << h), 0] = 0.5


@kernel
def expand(surface, parcel, work, now, h, c, s):
    """Series of the step of ``h`` from ``parcel.y`` at ``now`` to ``work.end``, into ``work.ser``. Returns their order.

    ``work.begun`` and ``work.ended`` are the accelerations at its ends, ``c`` and ``s`` cosine and sine at its begin.
    """
    y, end, ser, par = parcel.y, work.end, work.ser, parcel.par
    for k in range(3):
        velocities = y[at.UX + k], end[at.UX + k]
        ends = y[k], velocities[0], end[k], velocities[1]
        hermite(ser[at.S_X + k], ser[at.S_UX + k], ends, (work.begun[k], work.ended[k]), h)
    ser[at.S_C, 0], ser[at.S_S, 0] = c, s
    e, fade = decay(par, now), par[at.RATE] * h
    ser[at.S_EXP, 0] = e
    order = at.MAX_ORDER
    for k in range(at.MAX_ORDER):
        if k >= DEGREE:
            for row in range(3):
                ser[at.S_X + row, k + 1] = ser[at.S_UX + row, k] = 0.0
        turn_terms(ser, k)
        ser[at.S_EXP, k + 1] = -fade * ser[at.S_EXP, k] / (k + 1)
        size = par[at.RADIUS] * (abs(ser[at.S_C, k + 1]) + abs(ser[at.S_S, k + 1]))
        if k >= DEGREE and size <= SMALLEST and abs(ser[at.S_EXP, k + 1]) <= SMALLEST_DECAY:
            order = k + 1
            break
    for row in range(3):
        ser[at.S_UX + row, order] = 0.0
    for k in range(order + 1):
        place_terms(ser, k)
    expand_planes(surface, parcel, work, order)
    return order
