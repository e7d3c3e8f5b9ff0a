"""Wheels at the limit of their traction: on which branch of the law each is, and when it changes to another.

A wheel rolls while its resistance to slip stays within the limit that its load sets, and pulls with the limit beyond.
Force is continuous where branches meet, so it matters little on which of the two a wheel is taken to be there: a
wheel keeps its branch until it is past it by more than rounding, and which side the motion takes decides. Loads jump
with the support set, so every change of it asks all wheels again.

Where the resistance is infinite (``jumps``) a wheel between its limits sticks. The force jumps where a slip ends, which
is located here; where a wheel that sticks gives way is no root of the slip, and is located by the solver that knows the
forces of such wheels.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.events import crossing, note
from plant.kernels.common.lag_hooks import add_lag, lag_sway, with_lag_begun
from plant.kernels.common.roots import NONE
from plant.kernels.common.series import product
from plant.kernels.common.springs import LOAD_ZERO, gap, plane_at, stiffness

ROUNDING = 1e-14
"""A share of the speeds around that is none to rounding."""


SLIGHT = 5e-5
"""A slip this small, over a tolerance in m and per second, is none where the force jumps at none."""


@kernel
def jumps(par):
    """Whether a wheel's force jumps where its slip turns round: the law's resistance is infinite."""
    return par[at.LIMIT] == 0.0 and par[at.LIMIT_PER_SHARE] == 0.0


@kernel
def slight(par, rounding):
    """A slip that counts as none where force jumps, m/s; ``rounding`` is what rounding leaves of it."""
    return max(rounding, SLIGHT * par[at.TOLERANCE])


@kernel
def leeway(par, slip, rounding, branch):
    """A slip the other way, m/s, half of that at which a wheel on ``branch`` counts as turned round in a step.

    ``slip`` is that at the begin of the step: the error of the step before may have left it on the other side.
    """
    return max(slight(par, rounding), -branch * slip)


@kernel
def underside(ser, order, step):
    """Series of the velocity of the parcel's underside above ``X0``; the motors' decay into unit time."""
    scale = 1.0
    for k in range(1, order + 1):
        scale *= step
        ser[at.S_EXP, k] *= scale
    for k in range(order + 1):
        ser[at.S_VX, k] = ser[at.S_UX, k] + product(ser, at.S_OM, at.S_Y, k)
        ser[at.S_VY, k] = ser[at.S_UY, k] - product(ser, at.S_OM, at.S_X, k)


@kernel
def lever(surface, y, cell, axis):
    """Velocity along an axis, m/s, of the underside above a cell for every rad/s of turning."""
    return surface.pos[cell, 0] - y[0] if axis == 1 else y[1] - surface.pos[cell, 1]


@kernel
def slip_now(surface, y, free, e, cell, axis):
    """A wheel's slip now, and a speed that rounding can't tell from none beside it, m/s.

    ``free`` is the share of its surface speed at which the wheel would run without load.
    """
    steady, decay = free * surface.steady[cell, axis], free * surface.decay[cell, axis]
    turn = lever(surface, y, cell, axis) * y[at.OMEGA]
    along = y[at.UX + axis]
    zero = ROUNDING * (abs(steady) + e * abs(decay) + abs(along) + abs(turn))
    return steady + e * decay - along - turn, zero


@kernel
def slip_polynomial(surface, y, free, ser, order, cell, axis, g):
    """A wheel's slip along the step, m/s: coefficients into ``g``."""
    steady, decay = free * surface.steady[cell, axis], free * surface.decay[cell, axis]
    arm, row = lever(surface, y, cell, axis), at.S_VX + axis
    for k in range(order + 1):
        g[k] = decay * ser[at.S_EXP, k] - ser[row, k] - arm * ser[at.S_OM, k]
    g[0] += steady


@kernel
def sway(ser, order, row):
    """Bound on how far a series departs from its start within the unit step."""
    total = 0.0
    for k in range(1, order + 1):
        total += abs(ser[row, k])
    return total


@kernel
def next_branch(branch, slip, limit, zero):
    """The branch of a wheel that was on ``branch``: 1 or -1 where the slip exceeds the limit that way, else 0."""
    if branch == 0:
        if slip > limit + zero:
            return 1
        return -1 if slip < -limit - zero else 0
    if branch * slip >= limit - zero:
        return branch
    return -branch if branch * slip < -limit - zero else at.ZERO


@kernel
def grip_now(surface, parcel, seg, a0, bx, by, e, i, axis):
    """Slip and limit of a member's wheel on the plane ``a0 + b . r``: (slip, limit, what rounding leaves of them)."""
    par, y, cell = parcel.par, parcel.y, parcel.mem[i, at.CELL]
    rx, ry = surface.pos[cell, 0] - y[0] - seg[at.CX], surface.pos[cell, 1] - y[1] - seg[at.CY]
    share = stiffness(surface, cell, i) * (a0 + bx * rx + by * ry - gap(surface, cell))
    limit = par[at.LIMIT_PER_SHARE] * share + par[at.LIMIT]
    slip, zero = slip_now(surface, y, par[at.FREE_SPEED], e, cell, axis)
    return slip, limit, zero + LOAD_ZERO * par[at.LIMIT_PER_SHARE] * a0


@kernel
def carries(parcel, i):
    """Whether a member carries load in some mode."""
    for m in range(1 << parcel.ctl[at.N_GROUPS]):
        if parcel.mem[i, at.MARK + m] == at.ACTIVE:
            return True
    return False


@kernel
def pulls(surface, parcel, i):
    """Whether the wheels of member ``i`` pull in some mode."""
    return carries(parcel, i) and surface.grip[parcel.mem[i, at.CELL]] != 0.0


@kernel
def settle_branches(surface, parcel, seg, m, e):
    """Put every wheel that pulls in mode m on the branch that its load and slip ask for."""
    mem = parcel.mem
    a0, bx, by = plane_at(surface, seg, -seg[at.CX], -seg[at.CY])
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if mem[i, at.MARK + m] == at.ACTIVE and surface.grip[mem[i, at.CELL]] != 0.0:
            for axis in range(2):
                slip, limit, zero = grip_now(surface, parcel, seg, a0, bx, by, e, i, axis)
                column = at.BRANCH + 2 * m + axis
                mem[i, column] = next_branch(mem[i, column], slip, limit, zero)


@kernel
def change(surface, parcel, seg, work, order, o, i, axis, branch, zero, end):
    """Find when a member's wheel changes branch, ``2 zero`` past the branch's end, or ``NONE``; o: rows of its mode."""
    par, y, ser, g, slip, cell = parcel.par, parcel.y, work.ser, work.g, work.q, parcel.mem[i, at.CELL]
    rx, ry = surface.pos[cell, 0] - y[0] - seg[at.CX], surface.pos[cell, 1] - y[1] - seg[at.CY]
    slip_polynomial(surface, y, par[at.FREE_SPEED], ser, order, cell, axis, slip)
    add_lag(work, cell, axis, order, slip)
    share = par[at.LIMIT_PER_SHARE] if branch == 0 else -par[at.LIMIT_PER_SHARE]
    share *= stiffness(surface, cell, i)
    rest = par[at.LIMIT] if branch == 0 else -par[at.LIMIT]
    first = NONE
    for side in (-1, 1):
        if branch == -side:
            continue
        for k in range(order + 1):
            load = ser[o + at.M_A0, k] + ser[o + at.M_BX, k] * rx + ser[o + at.M_BY, k] * ry
            g[k] = share * load + side * slip[k]
        g[0] += rest + 2.0 * zero - share * gap(surface, cell)
        first = min(first, crossing(g, order, 0.0, end, work.p))
    return first


@kernel
def changes_in_mode(surface, parcel, work, order, m, end):
    """The first change of branch in mode m before ``end``. Returns (its time or ``end``, the cell or -1, the axis)."""
    mem, par, ser, seg = parcel.mem, parcel.par, work.ser, work.segs[m]
    o, first, first_axis = at.MODES_AT + m * at.MODE_ROWS, at.NO_CELL, at.ZERO
    a0, bx, by = ser[o + at.M_A0, 0], ser[o + at.M_BX, 0], ser[o + at.M_BY, 0]
    turn, fade = sway(ser, order, at.S_OM), par[at.FREE_SPEED] * sway(ser, order, at.S_EXP)
    # a share changes by no more than this anywhere under the parcel
    load = 2.0 * par[at.RADIUS] * (sway(ser, order, o + at.M_BX) + sway(ser, order, o + at.M_BY))
    for axis in range(2):
        along = sway(ser, order, at.S_VX + axis)
        for i in range(parcel.ctl[at.N_MEMBERS]):
            cell = mem[i, at.CELL]
            active = carries(parcel, i) if jumps(par) else mem[i, at.MARK + m] == at.ACTIVE
            if not active or surface.grip[cell] == 0.0:
                continue
            branch = mem[i, at.BRANCH + 2 * m + axis]
            if branch == 0 and jumps(par):
                continue
            slip, limit, zero = grip_now(surface, parcel, seg, a0, bx, by, ser[at.S_EXP, 0], i, axis)
            slip = with_lag_begun(work, cell, axis, slip)
            if jumps(par):
                zero = leeway(par, slip, zero, branch)
            room = limit - abs(slip) if branch == 0 else branch * slip - limit
            reach = along + par[at.LIMIT_PER_SHARE] * stiffness(surface, cell, i) * load
            reach += abs(lever(surface, parcel.y, cell, axis)) * turn
            reach += abs(surface.decay[cell, axis]) * fade + lag_sway(work, cell, axis)
            if room > reach * end * 1.000001:
                continue
            t = change(surface, parcel, seg, work, order, o, i, axis, branch, zero, end)
            if t <= end:
                end, first, first_axis = t, cell, axis
    return end, first, first_axis


@kernel
def branch_changes(surface, parcel, work, order, end, count):
    """The first wheel of the step that comes to another branch, in any mode: ``settle_branches`` then says which do."""
    culprit, axis = at.NO_CELL, at.ZERO
    # where the force jumps a wheel sticks or slips under its mean load, in all modes alike
    for m in range(1 if jumps(parcel.par) else 1 << parcel.ctl[at.N_GROUPS]):
        t, cell, along = changes_in_mode(surface, parcel, work, order, m, end)
        if cell >= 0:
            end, culprit, axis = t, cell, along
    if culprit >= 0:
        count = note(work.found, count, end, at.SWITCH, culprit, axis)
    return count, end
