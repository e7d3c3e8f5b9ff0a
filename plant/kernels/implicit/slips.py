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
from plant.kernels.common.branches import SLIGHT, leeway, lever, pulls, slight, slip_now
from plant.kernels.implicit.extrapolation import extrapolated
from plant.kernels.implicit.sliding import accelerate_along
from plant.kernels.implicit.step import rounded_slip, sign, slip_at
from plant.kernels.implicit.supports import decay

LARGEST = 10.0
"""How many times larger than a slip of no account one may be where a step ends because of it, ..."""
AIM = 3.0
"""... and how many times larger it is sought to be."""
LOOKS = 64
"""So many times is a step that ends there taken at most: bisection alone needs no more."""
CLOSE = 1e-13
"""Two ends of a step this near, s, are one."""
PROMPT = 1e-3
"""Where a force falls as a wheel gives way, the time is right to this share of the tolerance, per m/s."""
RESTING = 1e-9
"""A rate of slip that is none, over what the wheel's limit accelerates the parcel by."""


@kernel
def settle_slips(surface, parcel, e):
    """Put wheels that slip by more than the tolerance on their side; what is less, a step's error may have left."""
    mem, par = parcel.mem, parcel.par
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        if pulls(surface, parcel, i):
            for axis in range(2):
                slip, zero = slip_now(surface, parcel.y, par[at.FREE_SPEED], e, cell, axis)
                if abs(slip) > max(par[at.TOLERANCE], zero):
                    mem[i, at.BRANCH + axis] = 1 if slip > 0.0 else -1


@kernel
def gives_way(wheel, acceleration, axis):
    """The rate of slip of a wheel that sticks and, by the rule at an instant, gives way; 0 of one that doesn't."""
    rate = slip_at(wheel, acceleration, axis)
    none = max(rounded_slip(wheel, acceleration), RESTING * wheel[im.CX + axis])
    return rate if wheel[im.CX + axis] > 0.0 and abs(rate) > none else 0.0


@kernel
def give_way(surface, parcel, work):
    """Put wheels on their side that stuck and, by the accelerations asked for last, don't. Returns whether any."""
    mem, row, any_did = parcel.mem, at.ZERO, False
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if not pulls(surface, parcel, i):
            continue
        for axis in range(2):
            rate = gives_way(work.wheels[row], work.velocity, axis)
            if mem[i, at.BRANCH + axis] == 0 and rate != 0.0:
                mem[i, at.BRANCH + axis] = 1 if rate > 0.0 else -1
                any_did = True
        row += 1
    return any_did


@kernel
def slip_rate(surface, y, par, acceleration, e, cell, axis):
    """How fast a wheel's slip changes, m/s^2."""
    rate = -par[at.RATE] * e * par[at.FREE_SPEED] * surface.decay[cell, axis]
    rate -= acceleration[axis] + lever(surface, y, cell, axis) * acceleration[2]
    # the lever changes as the centre of mass moves
    return rate + y[at.OMEGA] * (y[at.UX] if axis == 1 else -y[at.UY])


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
                if mem[i, at.CELL] == int(work.found[k, at.EV_CELL]):
                    mem[i, at.BRANCH + int(work.found[k, at.EV_EDGE])] = 0
    for i in range(parcel.ctl[at.N_MEMBERS]):
        for axis in range(2):
            slip, zero = slip_now(surface, parcel.y, par[at.FREE_SPEED], e, mem[i, at.CELL], axis)
            side, none = mem[i, at.BRANCH + axis], slight(par, zero)
            rate = side * slip_rate(surface, parcel.y, par, work.before, e, mem[i, at.CELL], axis)
            if side * slip < -none or (side * slip <= none and rate < 0.0):
                mem[i, at.BRANCH + axis] = 0


@kernel
def rest_slips(surface, parcel, work, now, h):
    """Have wheels stick that didn't slip where the step just taken began, nor do where it ends."""
    mem, par = parcel.mem, parcel.par
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        for axis in range(2):
            if mem[i, at.BRANCH + axis] != 0:
                first, zero = slip_now(surface, work.begin, par[at.FREE_SPEED], decay(par, now), cell, axis)
                last, _ = slip_now(surface, parcel.y, par[at.FREE_SPEED], decay(par, now + h), cell, axis)
                if max(abs(first), abs(last)) <= slight(par, zero):
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
    y, par = parcel.y, parcel.par
    side, e = side_of(parcel, cell, axis), decay(par, now)
    slip, zero = slip_now(surface, work.begin, par[at.FREE_SPEED], e, cell, axis)
    zero = leeway(par, slip, zero, side)
    e = decay(par, now + t)
    slip, _ = slip_now(surface, y, par[at.FREE_SPEED], e, cell, axis)
    return side * slip + 2.0 * zero, side * slip_rate(surface, y, par, work.before, e, cell, axis)


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
        for axis in range(2):
            rate = gives_way(wheel, work.velocity, axis)
            wheel[im.SIDE_X + axis] = sign(rate)
            most = max(most, abs(rate))
    return most


@kernel
def left_over(surface, parcel, work, now):
    """The largest slip, m/s, of wheels that stick where the step begins."""
    par, most = parcel.par, 0.0
    for i in range(parcel.ctl[at.N_MEMBERS]):
        for axis in range(2):
            if parcel.mem[i, at.BRANCH + axis] == 0 and pulls(surface, parcel, i):
                cell = parcel.mem[i, at.CELL]
                slip, _ = slip_now(surface, work.begin, par[at.FREE_SPEED], decay(par, now), cell, axis)
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
        for axis in range(2):
            slip = slip_at(wheel, work.velocity, axis)
            slips = wheel[im.CX + axis] > 0.0 and abs(slip) > max(band, rounded_slip(wheel, work.velocity))
            wheel[im.SIDE_X + axis] = sign(slip) if slips else 0.0


@kernel
def commit_slips(surface, parcel, work):
    """Put wheels on the side that ``note_slips`` noted."""
    mem, row = parcel.mem, at.ZERO
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if not pulls(surface, parcel, i):
            continue
        for axis in range(2):
            side = work.wheels[row, im.SIDE_X + axis]
            if side != 0.0 and mem[i, at.BRANCH + axis] == 0:
                mem[i, at.BRANCH + axis] = 1 if side > 0.0 else -1
        row += 1
