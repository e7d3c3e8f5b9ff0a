"""Wheels whose force jumps where their slip ends, as by Coulomb's law: which slip, which stick, and until when.

A wheel that slips pulls with its limit, whichever way the step leads it; one that sticks pulls with what holds it, up
to its limit. The motion over a step is then smooth until a slip ends, which is a root of the slip (``branches``), or a
wheel that sticks gives way. The force is continuous there: a step is ended where the slip is as large as is of no
account, but larger than rounding, so that the wheel's side is beyond doubt. Where the static limit exceeds the kinetic
one the force falls, and the step is ended where the slip begins.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.branches import SLIGHT, leeway, pulls, slight, slip_now
from plant.kernels.common.lag_hooks import with_lag_begun
from plant.kernels.implicit.cones import LEFT, cone_rate, slip_rate
from plant.kernels.implicit.extrapolation import extrapolated
from plant.kernels.implicit.sliding import accelerate_along
from plant.kernels.implicit.step import LARGEST, axes, held_slip, rounded_slip, sign, wheel_slip
from plant.kernels.implicit.supports import decay

AIM = 3.0
"""How many times larger than a slip of no account one is sought to be where a step ends because of it."""
LOOKS = 64
"""So many times is a step that ends there taken at most: bisection alone needs no more."""
CLOSE = 1e-13
"""Two ends of a step this near, s, are one."""
PROMPT = 1e-3
"""Where a force falls as a wheel gives way, the time is right to this share of the tolerance, per m/s."""
RESTING = 1e-9
"""A rate of slip that is none, over what the wheel's limit accelerates the parcel by."""


@kernel
def member_slip(surface, parcel, work, e, cell, axis):
    """Slip of a wheel, or its size where a cell's wheels share a limit, and what rounding leaves of it, m/s."""
    slip, zero = wheel_slip(surface, parcel, work, e, cell, axis)
    if work.law[im.LOCATED] == im.CONES:
        other, more = wheel_slip(surface, parcel, work, e, cell, 1 - axis)
        return (slip * slip + other * other) ** 0.5, zero + more
    return slip, zero


@kernel
def member_slip_begun(surface, parcel, work, e, cell, axis):
    """As ``member_slip``, where the step began."""
    free = parcel.par[at.FREE_SPEED]
    slip, zero = slip_now(surface, work.begin, free, e, cell, axis)
    slip = with_lag_begun(work, cell, axis, slip)
    if work.law[im.LOCATED] == im.CONES:
        other, more = slip_now(surface, work.begin, free, e, cell, 1 - axis)
        other = with_lag_begun(work, cell, 1 - axis, other)
        return (slip * slip + other * other) ** 0.5, zero + more
    return slip, zero


@kernel
def settle_slips(surface, parcel, work, e):
    """Put wheels that slip by more than the tolerance on their side; what is less, a step's error may have left."""
    mem, par = parcel.mem, parcel.par
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        if pulls(surface, parcel, i):
            for axis in range(axes(work.law)):
                slip, zero = member_slip(surface, parcel, work, e, cell, axis)
                if abs(slip) > max(par[at.TOLERANCE], zero):
                    mem[i, at.BRANCH + axis] = 1 if slip > 0.0 else -1


@kernel
def gives_way(work, wheel, axis):
    """The rate of slip of a wheel that sticks and, by the rule at an instant, gives way; 0 of one that doesn't."""
    rate = held_slip(work, wheel, work.velocity, axis)
    none = max(rounded_slip(wheel, work.velocity), RESTING * wheel[im.CX + axis])
    return rate if abs(rate) > none else 0.0


@kernel
def give_way(surface, parcel, work):
    """Put wheels on their side that stuck and, by the accelerations asked for last, don't. Returns whether any."""
    mem, row, any_did = parcel.mem, at.ZERO, False
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if not pulls(surface, parcel, i):
            continue
        for axis in range(axes(work.law)):
            rate = gives_way(work, work.wheels[row], axis)
            if mem[i, at.BRANCH + axis] == 0 and rate != 0.0:
                mem[i, at.BRANCH + axis] = 1 if rate > 0.0 else -1
                any_did = True
        row += 1
    return any_did


@kernel
def end_slips(surface, parcel, work, count, together, e):
    """Have wheels stick whose slip ended: those of the events up to ``together``, and all that slip no more.

    So do those whose slip is of no account and ends next. Wheels in a row about one that sticks cease to slip at one
    instant. Were each to stick by itself, the first could be asked for more than it holds, and give way at once.
    """
    mem, par = parcel.mem, parcel.par
    for k in range(count):
        if work.found[k, at.EV_KIND] == at.SWITCH and work.found[k, at.EV_TIME] <= together:
            for i in range(parcel.ctl[at.N_MEMBERS]):
                if mem[i, at.CELL] == int(work.found[k, at.EV_CELL]) and work.law[im.LOCATED] == im.JUMPS:
                    mem[i, at.BRANCH + int(work.found[k, at.EV_EDGE])] = 0
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        for axis in range(axes(work.law)):
            slip, zero = member_slip(surface, parcel, work, e, cell, axis)
            side, none = mem[i, at.BRANCH + axis], slight(par, zero)
            if work.law[im.LOCATED] == im.CONES:
                rate, none = (
                    cone_rate(surface, parcel, work, work.before, e, cell),
                    max(none, LEFT * par[at.TOLERANCE]),
                )
            else:
                rate = side * slip_rate(surface, parcel, work, work.before, e, cell, axis)
            if side * slip < -none or (side * slip <= none and rate < 0.0):
                mem[i, at.BRANCH + axis] = 0


@kernel
def rest_slips(surface, parcel, work, now, h):
    """Have wheels stick that didn't slip where the step just taken began, nor do where it ends."""
    mem, par = parcel.mem, parcel.par
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        for axis in range(axes(work.law)):
            if mem[i, at.BRANCH + axis] != 0:
                first, zero = member_slip_begun(surface, parcel, work, decay(par, now), cell, axis)
                last, _ = member_slip(surface, parcel, work, decay(par, now + h), cell, axis)
                ends = work.law[im.LOCATED] == im.CONES and last < first
                if max(0.0 if ends else abs(first), abs(last)) <= slight(par, zero):
                    mem[i, at.BRANCH + axis] = 0


@kernel
def side_of(parcel, cell, axis):
    """On which side a member's wheel slips; 0 of one that sticks."""
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if parcel.mem[i, at.CELL] == cell:
            return parcel.mem[i, at.BRANCH + axis]
    return at.ZERO


@kernel
def slip_motion(surface, parcel, work, now, t, cell, axis):
    """Value and rate, ``t`` seconds into the step that begins ``now``, of the function whose root a slip's end is."""
    par = parcel.par
    if work.law[im.LOCATED] == im.CONES:
        return 0.0, 0.0
    side, e = side_of(parcel, cell, axis), decay(par, now)
    slip, zero = member_slip_begun(surface, parcel, work, e, cell, axis)
    zero = leeway(par, slip, zero, side)
    e = decay(par, now + t)
    slip, _ = member_slip(surface, parcel, work, e, cell, axis)
    return side * slip + 2.0 * zero, side * slip_rate(surface, parcel, work, work.before, e, cell, axis)


@kernel
def until_one_slips(surface, parcel, work, now, h):
    """End the step of ``h`` just taken where a wheel that sticks gives way. Returns (status, seconds, attempts).

    Left in ``work.wheels`` is which wheels do, on which side: ``commit_slips`` takes them for it.
    """
    if work.law[im.STATIC_RATIO] > 1.0:
        return until_a_force_falls(surface, parcel, work, now, h)
    low, high, slip, last = 0.0, h, work.first[im.SLIPPED], h
    older, slip_older = 0.0, 0.0
    status, attempts = at.MOVING, at.ZERO
    band = slight(parcel.par, rounded_slip(work.wheels[0], work.velocity)) if slip > 0.0 else 0.0
    while slip > LARGEST * band and high - low > CLOSE and attempts < LOOKS:
        begin = beginning(older, slip_older, high, slip)
        t = begin + (high - begin) * AIM * band / slip
        if begin < 0.0 or not low < t < high:
            t = 0.5 * (low + high)
        status, _ = extrapolated(surface, parcel, work, now, t)
        attempts += 1
        if status != at.MOVING:
            return status, t, attempts
        last = t
        if work.first[im.SLIPPED] > band:
            older, slip_older, high, slip = high, slip, t, work.first[im.SLIPPED]
        else:
            low = t
    if last != high:
        status, _ = extrapolated(surface, parcel, work, now, high)
        attempts += 1
    note_slips(parcel, work, band)
    return status, high, attempts


@kernel
def note_rates(surface, parcel, work, now):
    """Keep which wheels that stick give way at ``now``, and on which side. Returns the largest rate of slip."""
    accelerate_along(surface, parcel, work, now, work.ended)
    most = 0.0
    for row in range(min(parcel.ctl[at.N_MEMBERS], work.wheels.shape[0])):
        wheel = work.wheels[row]
        for axis in range(axes(work.law)):
            rate = gives_way(work, wheel, axis)
            wheel[im.SIDE_X + axis] = sign(rate)
            most = max(most, abs(rate))
    return most


@kernel
def left_over(surface, parcel, work, now):
    """The largest slip, m/s, of wheels that stick where the step begins."""
    par, most = parcel.par, 0.0
    for i in range(parcel.ctl[at.N_MEMBERS]):
        for axis in range(axes(work.law)):
            if parcel.mem[i, at.BRANCH + axis] == 0 and pulls(surface, parcel, i):
                cell = parcel.mem[i, at.CELL]
                slip, _ = member_slip_begun(surface, parcel, work, decay(par, now), cell, axis)
                most = max(most, abs(slip))
    return most


@kernel
def until_a_force_falls(surface, parcel, work, now, h):
    """As ``until_one_slips``, where a wheel pulls with less as soon as it slips.

    The time counts, not the slip: it is sought where, by the accelerations at the step's end, a wheel gives way.
    """
    low, high, last = 0.0, h, h
    older, rate_older = 0.0, 0.0
    status, attempts = at.MOVING, at.ZERO
    # a slip of no account, or one that the error of the step before left, may end again
    band = max(2.0 * left_over(surface, parcel, work, now), SLIGHT * parcel.par[at.TOLERANCE])
    slipped = work.first[im.SLIPPED] > band
    rate = note_rates(surface, parcel, work, now + h)
    enough = max(CLOSE, PROMPT * parcel.par[at.TOLERANCE])
    while (rate > 0.0 or slipped) and high - low > enough and attempts < LOOKS:
        t = beginning(older, rate_older, high, rate)
        if rate > 0.0 and low < t and high - t <= enough:
            break
        if not low < t < high or attempts % 4 == 3:
            t = 0.5 * (low + high)
        status, _ = extrapolated(surface, parcel, work, now, t)
        attempts += 1
        if status != at.MOVING:
            return status, t, attempts
        last, slips = t, work.first[im.SLIPPED] > band
        now_rate = note_rates(surface, parcel, work, now + t)
        if now_rate > 0.0 or slips:
            older, rate_older, high, rate, slipped = high, rate, t, now_rate, slips
        else:
            low = t
    if last != high:
        status, _ = extrapolated(surface, parcel, work, now, high)
        attempts += 1
        note_rates(surface, parcel, work, now + high)
    return status, high, attempts


@kernel
def beginning(later, slip_later, sooner, slip_sooner):
    """Time, s, at which a slip begins that is known at two later times; -1 if that can't be told.

    In the last part of a step a slip grows in proportion to the time since.
    """
    if not (later > sooner and slip_later > slip_sooner > 0.0):
        return -1.0
    return sooner - slip_sooner * (later - sooner) / (slip_later - slip_sooner)


@kernel
def note_slips(parcel, work, band):
    """Keep which wheels that stick slip by more than ``band`` at the end of the step just solved, and on which side."""
    for row in range(min(parcel.ctl[at.N_MEMBERS], work.wheels.shape[0])):
        wheel = work.wheels[row]
        for axis in range(axes(work.law)):
            slip = held_slip(work, wheel, work.velocity, axis)
            slips = abs(slip) > max(band, rounded_slip(wheel, work.velocity))
            wheel[im.SIDE_X + axis] = sign(slip) if slips else 0.0


@kernel
def commit_slips(surface, parcel, work):
    """Put wheels on the side that ``note_slips`` noted."""
    mem, row = parcel.mem, at.ZERO
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if not pulls(surface, parcel, i):
            continue
        for axis in range(axes(work.law)):
            side = work.wheels[row, im.SIDE_X + axis]
            if side != 0.0 and mem[i, at.BRANCH + axis] == 0:
                mem[i, at.BRANCH + axis] = 1 if side > 0.0 else -1
        row += 1
