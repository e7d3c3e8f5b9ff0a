"""One implicit step at given loads: a strictly convex problem in three unknowns, solved to rounding.

The velocity after a step of length h minimises ``|w - start|^2 / 2 + h sum phi_i(r_i(w))``, phi being the law's
dissipation potential and r_i the slip at wheel i. Newton's method on its gradient, which is continuous and piecewise
smooth; where a force is set-valued (Coulomb's at no slip) an augmented Lagrangian around it: the force is
``clamp(lambda + rho r)``, and lambda becomes that force until it changes no more, whatever rho.
"""

from __future__ import annotations

from math import exp, inf, isfinite, nan

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.branches import pulls, slight, slip_now
from plant.kernels.common.lag_hooks import with_lag
from plant.kernels.common.motion import share_of, solve
from plant.kernels.common.springs import foreseen, gap, note_gaps, plane_at, shift, stiffness
from plant.kernels.implicit.hooks import lighten, slip_left, summed, unloaded
from plant.kernels.implicit.traction_hooks import drag, factor


@kernel
def clamped(q, b, c):
    """A force within its limit, and how it answers to slip."""
    if q > c:
        return c, 0.0
    if q < -c:
        return -c, 0.0
    return q, b


@kernel
def unclamped(row, w):
    """Force of one cell's wheels as it would be without a limit, multipliers included."""
    qx = row[im.LX] + row[im.BX] * (row[im.SX] - w[0] - row[im.AX] * w[2])
    qy = row[im.LY] + row[im.BY] * (row[im.SY] - w[1] - row[im.AY] * w[2])
    return qx, qy


@kernel
def pull(row, w, isotropic):
    """The limited force of one cell's wheels, and its derivative by slip: (fx, fy, kxx, kxy, kyy)."""
    qx, qy = unclamped(row, w)
    if isotropic == 0.0:
        fx, kx = clamped(qx, row[im.BX], row[im.CX])
        fy, ky = clamped(qy, row[im.BY], row[im.CY])
        return fx, fy, kx, 0.0, ky
    b, c = row[im.BX], row[im.CX]
    size = (qx * qx + qy * qy) ** 0.5
    if size <= c:
        return qx, qy, b, 0.0, b
    ex, ey, k = qx / size, qy / size, b * c / size
    return c * ex, c * ey, k * ey * ey, -k * ex * ey, k * ex * ex


@kernel
def unlimited(row, w):
    """Force at one cell that no limit holds for: the law's push and viscous part, and what drags, ``G - K v``."""
    vx, vy = w[0] + row[im.AX] * w[2], w[1] + row[im.AY] * w[2]
    return row[im.GX] - row[im.K] * vx, row[im.GY] - row[im.K] * vy


EPSILON = 2.3e-16
INSTANT = 1e-9
"""Forces are asked for by a step this short, s, and a parcel that tips does so within this time."""
SMALLEST = 1e-290
"""Velocities below this, m/s, are none: a share of theirs is no number any more."""
NEWTON_STEPS = 100
MULTIPLIER_STEPS = 100
FIRST_WEIGHT = 1e4
"""The augmented Lagrangian's weight at first: resistance of all sticking wheels together over the parcel's inertia."""
LAST_WEIGHT = 1e6
FLAT = 1e-3
"""How flat the potential must be along a Newton step where the step ends, over its slope where it begins."""
ROUNDED = 64.0
"""A slip is the difference of speeds that are wrong by so many roundings at most."""
LARGEST = 10.0
"""How many times larger than a slip of no account one may be where a step ends because of it."""
AGREED = 1e-12
"""A slip that rounding can't tell from none, over the speeds around."""


@kernel
def sign(value):
    """-1, 0 or 1."""
    if value > 0.0:
        return 1.0
    return -1.0 if value < 0.0 else 0.0


@kernel
def slip_at(row, w, axis):
    """Slip of one wheel at the velocity ``w``, m/s."""
    return row[im.SX + axis] - w[axis] - row[im.AX + axis] * w[2]


@kernel
def rounded_slip(row, w):
    """A slip that rounding can't tell from none at the velocity ``w``, m/s."""
    return ROUNDED * EPSILON * (row[im.SUMMED] + abs(w[0]) + abs(w[1]) + abs(w[2]))


@kernel
def slips_jump(law):
    """Whether it is located where wheels begin and cease to slip."""
    return law[im.LOCATED] >= im.JUMPS


@kernel
def axes(law):
    """How many slips of a cell begin and end by themselves."""
    return 1 if law[im.LOCATED] == im.CONES else 2


@kernel
def held_slip(work, row, w, axis):
    """Slip, m/s, at the velocity ``w`` of a wheel held by up to its limit; its size where wheels share a limit.

    0 of a wheel that slips all along.
    """
    if not row[im.CX + axis] > 0.0 or row[im.SLIPS] != 0.0:
        return 0.0
    slip = slip_left(work, row, w, axis)
    if work.law[im.LOCATED] != im.CONES:
        return slip
    other = slip_left(work, row, w, 1 - axis)
    return (slip * slip + other * other) ** 0.5


@kernel
def wheel_slip(surface, parcel, work, e, cell, axis):
    """A wheel's slip now, and a speed that rounding can't tell from none beside it, m/s.

    ``e`` is the motors' decay factor now.
    """
    slip, zero = slip_now(surface, parcel.y, parcel.par[at.FREE_SPEED], e, cell, axis)
    return with_lag(work, cell, axis, slip), zero


@kernel
def largest_slip(work, count):
    """The largest slip, m/s, of the wheels held by up to their limit in the step just solved; 0 where all stick."""
    most = 0.0
    for i in range(count):
        row = work.wheels[i]
        for axis in range(axes(work.law)):
            slip = abs(held_slip(work, row, work.velocity, axis))
            if slip > max(most, rounded_slip(row, work.velocity)):
                most = slip
    return most


@kernel
def hold_branches(mem, i, row, m, limit_x, limit_y, sticks):
    """Let the wheels of member ``i`` pull as on the branches that they are on in mode m, wherever the slip leads.

    Where wheels stick (``sticks`` not 0) those between the limits have them yet.
    """
    for axis in range(2):
        branch = mem[i, at.BRANCH + 2 * m + axis]
        if branch != 0:
            row[im.CX + axis] = 0.0
        elif sticks == 0.0:
            row[im.CX + axis] = 1e300
        row[im.GX + axis] += branch * (limit_x if axis == 0 else limit_y)


@kernel
def hold_cone(surface, parcel, work, i, row, limit, e, h):
    """Let the wheels of member ``i``, which share a limit, pull as if they slip or stick as they did; ``e``: decay now.

    In an instant wheels that slip pull along their slip. So do those whose limit has fallen below zero, to lead the
    motion on smoothly. In any other step the force follows the slip.
    """
    row[im.SLIPS] = parcel.mem[i, at.BRANCH]
    if parcel.mem[i, at.BRANCH] == 0:
        return
    cell = parcel.mem[i, at.CELL]
    x, zero = wheel_slip(surface, parcel, work, e, cell, 0)
    y, more = wheel_slip(surface, parcel, work, e, cell, 1)
    row[im.WAS_X], row[im.WAS_Y] = x, y
    size = (x * x + y * y) ** 0.5
    # of a slip that just begins or ends the direction is that in which it changes
    if (h == 0.0 or limit < 0.0) and size > LARGEST * slight(parcel.par, zero + more):
        row[im.CX] = row[im.CY] = 0.0
        row[im.GX] += limit * x / size
        row[im.GY] += limit * y / size


@kernel
def keep_slips(surface, parcel, work, law, i, row, e):
    """Let the wheels of member ``i`` that stick keep, for a step, the slip that the error of the one before left them.

    ``e`` is the motors' decay factor now. To end that slip within an instant would take any force.
    """
    par, cell = parcel.par, parcel.mem[i, at.CELL]
    for axis in range(2):
        slip, _ = wheel_slip(surface, parcel, work, e, cell, axis)
        branch = parcel.mem[i, at.BRANCH + (axis if axes(law) == 2 else 0)]
        if branch == 0 and abs(slip) <= par[at.TOLERANCE]:
            row[im.SX + axis] -= slip


@kernel
def press(surface, parcel, work, ahead_x, ahead_y):
    """Every mode's plane of the springs, the parcel's centre being so far ahead, into ``work.planes``."""
    groups = parcel.ctl[at.N_GROUPS]
    for m in range(1 << groups):
        seg, plane = work.segs[m], work.planes[m]
        sx, sy = shift(surface, m)
        if groups > 0:
            note_gaps(surface, parcel, seg, at.MARK + m)
        mx, my = ahead_x + sx - seg[at.CX], ahead_y + sy - seg[at.CY]
        plane[0], plane[1], plane[2] = plane_at(surface, seg, mx, my)


@kernel
def mean_share(surface, parcel, work, i, continues):
    """A member's load by the planes, and the share of the motion in which it carries any, modes mixed.

    A load below zero counts only if it ``continues`` from above.
    """
    mem, groups = parcel.mem, parcel.ctl[at.N_GROUPS]
    cell, load, weight = mem[i, at.CELL], 0.0, 0.0
    rx, ry = surface.pos[cell, 0] - parcel.y[0], surface.pos[cell, 1] - parcel.y[1]
    for m in range(1 << groups):
        if mem[i, at.MARK + m] != at.ACTIVE:
            continue
        seg, plane = work.segs[m], work.planes[m]
        pressed = plane[0] + plane[1] * (rx - seg[at.CX]) + plane[2] * (ry - seg[at.CY]) - gap(surface, cell)
        share = stiffness(surface, cell, i) * pressed
        if share > 0.0 or continues:
            part = share_of(work.fraction, groups, m)
            load += part * share
            weight += part
        elif groups == 0:
            weight = 1.0
    return load, weight


@kernel
def share_in(surface, parcel, work, i, m, continues):
    """As ``mean_share``, of mode m alone: the load, and 1 where it counts."""
    mem = parcel.mem
    if mem[i, at.MARK + m] != at.ACTIVE:
        return 0.0, 0.0
    cell, seg, plane = mem[i, at.CELL], work.segs[m], work.planes[m]
    rx, ry = surface.pos[cell, 0] - parcel.y[0] - seg[at.CX], surface.pos[cell, 1] - parcel.y[1] - seg[at.CY]
    load = stiffness(surface, cell, i) * (plane[0] + plane[1] * rx + plane[2] * ry - gap(surface, cell))
    if load <= 0.0 and not continues:
        return 0.0, 0.0
    return load, 1.0


@kernel
def list_wheels(surface, parcel, work, law, e, h, i, m, count, share, part):
    """List member i's wheels in row ``count`` of ``work.wheels``, in mode m, with a ``share`` of the weight on them.

    ``part`` is the share of the motion in which the wheels carry it; others as of ``grasp``.
    """
    mem, y, row, cell = parcel.mem, parcel.y, work.wheels[count], parcel.mem[i, at.CELL]
    arm, ahead_x, ahead_y = work.pace[im.GYRATION], h * y[at.UX], h * y[at.UY]
    rx, ry = surface.pos[cell, 0] - y[0], surface.pos[cell, 1] - y[1]
    vx, vy = unloaded(surface, cell, e)
    row[im.CELL] = cell
    row[im.AX], row[im.AY] = (ahead_y - ry) / arm, (rx - ahead_x) / arm
    row[im.SX], row[im.SY] = law[im.FREE_SPEED] * vx, law[im.FREE_SPEED] * vy
    row[im.SUMMED] = law[im.FREE_SPEED] * summed(surface, cell, e)
    along_x, along_y = factor(surface, cell)
    along_x *= share
    along_y *= share
    # infinite where wheels that feel what they pull let a set-valued force slow them
    stiff = part * law[im.STIFFNESS] if law[im.STIFFNESS] < inf else inf
    row[im.BX] = stiff + law[im.STIFFNESS_PER_SHARE] * along_x
    row[im.BY] = stiff + law[im.STIFFNESS_PER_SHARE] * along_y
    limit_x = part * law[im.LIMIT] + law[im.LIMIT_PER_SHARE] * along_x
    limit_y = part * law[im.LIMIT] + law[im.LIMIT_PER_SHARE] * along_y
    row[im.CX], row[im.CY] = max(limit_x, 0.0), max(limit_y, 0.0)
    if part < 0.0:
        # a fraction just outside [0, 1] on the way to where it is right
        row[im.CX], row[im.CY] = abs(limit_x), abs(limit_y)
    row[im.GX] = row[im.GY] = push_x = push_y = 0.0
    if law[im.PUSH_PER_SHARE] != 0.0:
        # a wheel that turns round does so at the end of a step: which way it runs is asked in the middle
        midway = e * exp(0.5 * parcel.par[at.RATE] * h) if e > 0.0 else e
        vx, vy = unloaded(surface, cell, midway)
        push_x, push_y = law[im.PUSH_PER_SHARE] * along_x, law[im.PUSH_PER_SHARE] * along_y
        row[im.GX], row[im.GY] = push_x * sign(vx), push_y * sign(vy)
    row[im.LX] = row[im.LY] = 0.0
    row[im.K] = part * law[im.VISCOUS]
    row[im.SLIPS] = 0.0
    if law[im.LOCATED] == im.CONES:
        hold_cone(surface, parcel, work, i, row, limit_x, e * exp(parcel.par[at.RATE] * h), h)
    elif law[im.LOCATED] != 0.0:
        hold_branches(mem, i, row, m, limit_x, limit_y, law[im.LOCATED] - im.KINKS)
    if slips_jump(law) and h <= INSTANT:
        keep_slips(surface, parcel, work, law, i, row, e * (1.0 + parcel.par[at.RATE] * h))
    elif law[im.LOCATED] == im.CONES and law[im.WHEEL] != 0.0 and parcel.ctl[at.N_GROUPS] > 0:
        # no fraction makes up for what would end such a slip in a short step
        keep_slips(surface, parcel, work, law, i, row, e * exp(parcel.par[at.RATE] * h))
    lighten(work, parcel, count, cell, push_x, push_y, h)
    if law[im.VISCOUS] != 0.0:
        row[im.GX] += row[im.K] * row[im.SX]
        row[im.GY] += row[im.K] * row[im.SY]
    row[im.OWN_K] = row[im.K]
    row[im.K] += drag(surface, share)


@kernel
def grasp(surface, parcel, work, law, e, h):
    """List the wheels that pull, with the law's coefficients at the loads that ``settle`` found. Returns how many.

    ``e`` is the motors' decay factor at the end of the step, h s away. Levers and loads of the supports found are
    those where the parcel's present velocity leads until then: a wheel that sticks all along sticks with the levers of
    the end, and so does the next step's.
    """
    y = parcel.y
    press(surface, parcel, work, h * y[at.UX], h * y[at.UY])
    # past the instant at which a support is lifted its load goes on falling, until the step is ended there
    held = law[im.WHEEL] == 0.0 or slips_jump(law)
    continues = work.pace[im.LOCATES] != 0.0 and held and foreseen(surface)
    count = at.ZERO
    modes = 1 << parcel.ctl[at.N_GROUPS] if law[im.CAPTURES] == im.BY_MODES else 1
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if not pulls(surface, parcel, i):
            continue
        for m in range(modes):
            if modes > 1:
                share, part = share_in(surface, parcel, work, i, m, continues)
                weight = share_of(work.fraction, parcel.ctl[at.N_GROUPS], m)
                share, part = weight * share, weight * part
            else:
                share, part = mean_share(surface, parcel, work, i, continues)
            list_wheels(surface, parcel, work, law, e, h, i, m, count, share, part)
            count += 1
    return count


@kernel
def slope(work, count, isotropic, h, w):
    """Gradient and Hessian of the step's problem at ``w``. Returns the sum of all impulses' sizes."""
    wheels, start, grad, hessian = work.wheels, work.start, work.grad, work.hessian
    impulses = 0.0
    for k in range(3):
        grad[k] = w[k] - start[k]
        for j in range(3):
            hessian[k, j] = 1.0 if j == k else 0.0
    for i in range(count):
        row = wheels[i]
        ax, ay = row[im.AX], row[im.AY]
        fx, fy, kxx, kxy, kyy = pull(row, w, isotropic)
        gx, gy = unlimited(row, w)
        fx, fy = h * (fx + gx), h * (fy + gy)
        impulses += abs(fx) + abs(fy)
        kxx, kxy, kyy = h * (kxx + row[im.K]), h * kxy, h * (kyy + row[im.K])
        grad[0] -= fx
        grad[1] -= fy
        grad[2] -= ax * fx + ay * fy
        hessian[0, 0] += kxx
        hessian[0, 1] += kxy
        hessian[1, 1] += kyy
        hessian[0, 2] += kxx * ax + kxy * ay
        hessian[1, 2] += kxy * ax + kyy * ay
        hessian[2, 2] += ax * (kxx * ax + 2.0 * kxy * ay) + kyy * ay * ay
    hessian[1, 0], hessian[2, 0], hessian[2, 1] = hessian[0, 1], hessian[0, 2], hessian[1, 2]
    return impulses


@kernel
def slope_along(work, count, isotropic, h, w, t):
    """Go to ``w + t step``: gradient there. Returns (its component along the step, the impulses' sizes)."""
    trial, step, grad = work.trial, work.step, work.grad
    for k in range(3):
        trial[k] = w[k] + t * step[k]
    impulses = slope(work, count, isotropic, h, trial)
    return grad[0] * step[0] + grad[1] * step[1] + grad[2] * step[2], impulses


@kernel
def flattest(work, count, isotropic, h, w, before, after):
    """Go where the potential along a Newton step that overshoots is least (Illinois). Returns the impulses' sizes."""
    impulses = 0.0
    low, high, at_low, at_high = 0.0, 1.0, before, after
    for _ in range(60):
        t = (low * at_high - high * at_low) / (at_high - at_low)
        here, impulses = slope_along(work, count, isotropic, h, w, t)
        if abs(here) <= FLAT * abs(before) or not low < t < high:
            break
        if here > 0.0:
            high, at_high, at_low = t, here, 0.5 * at_low
        else:
            low, at_low, at_high = t, here, 0.5 * at_high
    return impulses


@kernel
def minimise(work, count, isotropic, h, w):
    """Newton's method from ``w`` to the least potential at the present multipliers.

    Returns the size of the velocities to whose rounding it is right, or -1 where it did not get there; where forces are
    no numbers, neither is then ``w``. There is where a step changes nothing but rounding: the gradient's own rounding
    is large along stiff wheels and says little.
    """
    grad, step, rhs, start = work.grad, work.step, work.rhs, work.start
    best, stalled = 1e300, 0
    impulses = slope(work, count, isotropic, h, w)
    for _ in range(NEWTON_STEPS):
        for k in range(3):
            rhs[k] = -grad[k]
        solve(work.hessian, work.hessian.shape[0], rhs, step, work.scratch)
        if not isfinite(step[0] + step[1] + step[2]):
            w[0] = w[1] = w[2] = nan
            return -1.0
        off, scale, before = 0.0, max(impulses, SMALLEST), 0.0
        for k in range(3):
            off, scale = max(off, abs(step[k])), max(scale, abs(w[k]), abs(start[k]))
            before -= rhs[k] * step[k]
        # the last digit may come and go
        stalled = stalled + 1 if off > 0.5 * best else 0
        if off <= EPSILON * scale or (stalled >= 4 and off <= 64.0 * EPSILON * scale):
            return scale
        best = min(best, off)
        after, impulses = slope_along(work, count, isotropic, h, w, im.UNITY)
        if after > FLAT * abs(before):
            impulses = flattest(work, count, isotropic, h, w, before, after)
        moved = 0.0
        for k in range(3):
            moved = max(moved, abs(work.trial[k] - w[k]))
            w[k] = work.trial[k]
        # beside a kink the step may be long, and the way to where the potential is least shorter than rounding
        if moved <= EPSILON * scale:
            return scale
    return -1.0


@kernel
def follow(work, count, isotropic, w, scale):
    """Take the forces at ``w`` for multipliers. Returns (how much they changed, how much of that is rounding).

    ``scale`` is the size of the velocities to whose rounding w is right.
    """
    wheels = work.wheels
    change = rounding = 0.0
    for i in range(count):
        row = wheels[i]
        fx, fy, kxx, _, kyy = pull(row, w, isotropic)
        change += abs(fx - row[im.LX]) + abs(fy - row[im.LY])
        speeds = row[im.SUMMED] + scale
        # at a limit or not, by rounding: in a step of an instant the weights make a force of it
        if abs(slip_at(row, w, 0)) <= 8.0 * EPSILON * speeds:
            kxx = row[im.BX]
        if abs(slip_at(row, w, 1)) <= 8.0 * EPSILON * speeds:
            kyy = row[im.BY]
        rounding += EPSILON * (abs(fx) + abs(fy) + (kxx + kyy) * speeds)
        row[im.LX], row[im.LY] = fx, fy
    return change, rounding


@kernel
def stick(work, count, isotropic, w):
    """Velocities that rounding can't tell from sticking become it: a parcel that sticks doesn't creep.

    Only where the wheels that stick agree on a motion without rotation; those that slip have no say.
    """
    wheels, start = work.wheels, work.start
    agree_x = agree_y = True
    stuck_x = stuck_y = False
    sx = sy = scale = 0.0
    for k in range(3):
        scale = max(scale, abs(start[k]))
    for i in range(count):
        row = wheels[i]
        scale = max(scale, abs(row[im.SX]), abs(row[im.SY]))
        if isotropic == 0.0:
            holds_x, holds_y = abs(row[im.LX]) < row[im.CX], abs(row[im.LY]) < row[im.CY]
        else:
            holds_x = holds_y = (row[im.LX] * row[im.LX] + row[im.LY] * row[im.LY]) ** 0.5 < row[im.CX]
        if holds_x:
            agree_x, sx, stuck_x = agree_x and (not stuck_x or row[im.SX] == sx), row[im.SX], True
        if holds_y:
            agree_y, sy, stuck_y = agree_y and (not stuck_y or row[im.SY] == sy), row[im.SY], True
    tiny = AGREED * scale
    along_x, along_y = agree_x and stuck_x, agree_y and stuck_y
    if along_x and abs(w[0] - sx) <= tiny:
        w[0] = sx
    if along_y and abs(w[1] - sy) <= tiny:
        w[1] = sy
    if (along_x or along_y) and abs(w[2]) <= tiny:
        w[2] = 0.0


@kernel
def new_velocity(work, count, law, h, w):
    """Velocity after a step of ``h`` seconds from ``work.start``, into ``w``. Returns whether it was found."""
    isotropic = law[im.ISOTROPIC]
    for k in range(3):
        w[k] = work.start[k]
    if law[im.SET_VALUED] == 0.0 or count == 0:
        return minimise(work, count, isotropic, h, w) >= 0.0
    weight, inertia = FIRST_WEIGHT, 1.0
    for i in range(count):
        # what resists without a limit holds the parcel as its inertia does
        inertia += h * work.wheels[i, im.K]
    for _ in range(MULTIPLIER_STEPS):
        for i in range(count):
            work.wheels[i, im.BX] = work.wheels[i, im.BY] = weight * inertia / (h * count)
        scale = minimise(work, count, isotropic, h, w)
        if not scale >= 0.0:
            return False
        change, rounding = follow(work, count, isotropic, w, scale)
        if change <= 4.0 * rounding:
            stick(work, count, isotropic, w)
            return True
        weight = min(4.0 * weight, LAST_WEIGHT)
    return False


@kernel
def at_limit(row, w, isotropic):
    """On which side each of a cell's wheels is at its limit, as -1, 0 or 1: (x, y)."""
    fx, fy, _, _, _ = pull(row, w, isotropic)
    if isotropic == 0.0:
        x = sign(fx) if abs(fx) >= row[im.CX] else 0.0
        y = sign(fy) if abs(fy) >= row[im.CY] else 0.0
        return x, y
    if (fx * fx + fy * fy) ** 0.5 >= 0.999999 * row[im.CX]:
        # in quarters: slip that turns round must not look like slip that went on
        return sign(fx), sign(fy)
    return 0.0, 0.0


@kernel
def regime(work, count, isotropic, w):
    """A number that tells which wheels are at their limits, on which side: it changes where a law changes branch."""
    total = 0.0
    for i in range(count):
        x, y = at_limit(work.wheels[i], w, isotropic)
        # weights of which no small sums cancel
        total += (i + 1.37) ** 0.5 * x + (i + 1.91) ** 0.5 * y
    return total
