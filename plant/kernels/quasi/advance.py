"""The quasi-static solver's loop of one parcel: positions follow the velocity at which all pulls balance.

Bogacki and Shampine's pair of orders 3 and 2 (Applied Mathematics Letters 2, 1989). Velocity jumps where supports
change; a step across a jump shrinks until it counts for little, and where supports change too often to be followed one
by one, plain steps of bounded number go across.
"""

from __future__ import annotations

from math import exp, isfinite

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.footprint import fill, may_go_on, sampled_until
from plant.kernels.implicit.extrapolation import length
from plant.kernels.implicit.step import grasp, new_velocity
from plant.kernels.implicit.step_events import note_changes, remember
from plant.kernels.implicit.supports import decay, find_loads

NOW = 0.0
"""Forces are those of this instant, not those of an instant ahead. Named, for the compiler: see ``layout.ZERO``."""
LONG = 1e4
"""A first proximal step, over the time in which the pulls would stop or speed up the parcel; ..."""
LONG_OF_JUMPS = 1e2
"""... the same where pulls are set-valued: their potential has corners, which a step of finite length reaches; ..."""
LONGER = 100.0
"""... each that follows is so much longer, for directions in which little pulls. One that can't be solved is tried as
much shorter, and those after it stay so."""
PASSES = 40
LEVEL = 1e-6
"""A set-valued potential so level that a step as long changes the velocity by no more than this share is a plateau."""
ROUNDING = 2.3e-16
"""Of pulls that cancel: what is left drives a proximal step by as much, over its length, in directions left open."""


@kernel
def stopping_time(work, count, law):
    """Time in which the pulls would stop the parcel, s, and the size of speeds around, m/s; (0, 0) where all stands."""
    start, wheels = work.start, work.wheels
    resistance = limit = speed = 0.0
    for k in range(3):
        speed = max(speed, abs(start[k]))
    for i in range(count):
        row = wheels[i]
        resistance += 0.5 * (row[im.BX] + row[im.BY]) + row[im.K]
        limit += 0.5 * (row[im.CX] + row[im.CY])
        speed = max(speed, abs(row[im.SX]), abs(row[im.SY]))
    if speed == 0.0:
        return 0.0, 0.0
    length = 0.0 if law[im.SET_VALUED] != 0.0 else 1.0 / resistance
    # without a limit that is infinite, and this adds nothing
    return length + speed / limit, speed


@kernel
def balance(work, count, law, w):
    """The velocity at which the pulls of the wheels listed balance, nearest to ``work.start``, into ``w``.

    Returns whether it was found. Where nothing pulls it is ``work.start``.
    """
    start = work.start
    for k in range(3):
        w[k] = start[k]
    stopping, speed = stopping_time(work, count, law) if count > 0 else (0.0, 0.0)
    if speed == 0.0:
        return True
    jumps = law[im.SET_VALUED] != 0.0
    longer, factor, found = (LONG_OF_JUMPS if jumps else LONG), LONGER, at.UNDONE
    for passed in range(PASSES):
        if not new_velocity(work, count, law, longer * stopping, w):
            factor = 1.0
            longer /= LONGER
            continue
        found = at.COMPLETE
        moved = 0.0
        for k in range(3):
            moved = max(moved, abs(w[k] - start[k]))
            start[k] = w[k]
        if moved <= max(longer * ROUNDING, LEVEL if jumps else 0.0) * speed:
            break
        # a corner is reached by the first, and the second tells
        longer *= factor if passed > 0 or not jumps else 1.0
    return found


@kernel
def velocity(surface, parcel, work, time, last, found):
    """Velocity at the parcel's pose at ``time``, into ``found[:3]``: x, y and turning. Returns the status.

    ``last[3:]`` is the velocity from which it changes least.
    """
    status = find_loads(surface, parcel, work)
    if status != at.MOVING:
        return status
    arm, start, w = work.pace[im.GYRATION], work.start, work.velocity
    count = grasp(surface, parcel, work, work.law, decay(parcel.par, time), NOW)
    start[0], start[1], start[2] = last[at.UX], last[at.UY], arm * last[at.OMEGA]
    if not balance(work, count, work.law, w):
        return im.NOT_SOLVED
    found[0], found[1], found[2] = w[0], w[1], w[2] / arm
    return at.MOVING


JUMP = 1e-2
"""A step however short may be wrong by this share of the tolerance: a jump of the velocity can't be had for less."""
INSTANT = 1e-9
"""A parcel that tips does so within this time, s."""
SHORTEST = 1e-12
"""No step is shorter, s."""
SOON = 0.05
"""Support changes are forgotten after this time, s; ..."""
MANY = 20.0
"""... more than this many at once are chatter: ..."""
SHORT = 1e-4
"""... steps across it need be no shorter than this, s."""


@kernel
def place(y, begin, slopes, h, one, two, three):
    """The pose of a stage: where the slopes found so far lead in ``h``, weighted."""
    for k in range(3):
        y[k] = begin[k] + h * (one * slopes[0, k] + two * slopes[1, k] + three * slopes[2, k])


@kernel
def checked_velocity(surface, parcel, work, time, found):
    """``velocity`` where the parcel is, if it is anywhere. Returns the status."""
    y = parcel.y
    for k in range(3):
        if not isfinite(y[k]):
            return at.NOT_FINITE
    status = velocity(surface, parcel, work, time, work.begin, found)
    if status == at.MOVING and not (isfinite(found[0]) and isfinite(found[1]) and isfinite(found[2])):
        return at.NOT_FINITE
    return status


@kernel
def attempt(surface, parcel, work, now, h):
    """A step from ``work.begin``, whose velocity stands there. Returns (status, error in m).

    Leaves pose and velocity at the step's end in ``parcel.y``, and the loads there.
    """
    y, begin, slopes, error = parcel.y, work.begin, work.table, work.error
    for k in range(3):
        slopes[0, k], slopes[1, k], slopes[2, k] = begin[at.UX + k], 0.0, 0.0
    place(y, begin, slopes, h, 0.5, 0.0, 0.0)
    status = checked_velocity(surface, parcel, work, now + 0.5 * h, slopes[1])
    if status == at.MOVING:
        place(y, begin, slopes, h, 0.0, 0.75, 0.0)
        status = checked_velocity(surface, parcel, work, now + 0.75 * h, slopes[2])
    if status == at.MOVING:
        place(y, begin, slopes, h, 2.0 / 9.0, 1.0 / 3.0, 4.0 / 9.0)
        status = checked_velocity(surface, parcel, work, now + h, slopes[3])
    if status != at.MOVING:
        return status, 1e300
    for k in range(3):
        y[at.UX + k] = slopes[3, k]
        error[k] = -5.0 / 72.0 * slopes[0, k] + slopes[1, k] / 12.0 + slopes[2, k] / 9.0 - slopes[3, k] / 8.0
    return at.MOVING, h * length(error, at.ZERO, parcel)


@kernel
def plain(surface, parcel, work, now, h):
    """Euler's step, taken as it is. Returns the status."""
    y, begin, slopes = parcel.y, work.begin, work.table
    for k in range(3):
        y[k] = begin[k] + h * begin[at.UX + k]
    status = checked_velocity(surface, parcel, work, now + h, slopes[3])
    if status == at.MOVING:
        for k in range(3):
            y[at.UX + k] = slopes[3, k]
    return status


@kernel
def controlled(surface, parcel, work, now, left):
    """One step of at most ``left`` seconds that is right to the tolerance. Returns (status, seconds, attempts)."""
    pace, attempts = work.pace, at.ZERO
    h = min(left, pace[im.NEXT])
    # so short that the parcel hardly moves, a step is taken as it is
    least = JUMP * pace[im.TOLERANCE] / (length(work.begin, at.UX, parcel) + 1e-300)
    least = max(SHORTEST, min(least, 1.0), SHORT if pace[im.CROWD] > MANY else 0.0)
    while True:
        attempts += 1
        status, error = attempt(surface, parcel, work, now, h)
        allowed = pace[im.TOLERANCE] * max(h, JUMP)
        if status == at.MOVING and error <= allowed:
            factor = 5.0 if error == 0.0 else min(5.0, 0.8 * (allowed / error) ** (1.0 / 3.0))
            pace[im.NEXT] = max(pace[im.NEXT], h * factor) if h < pace[im.NEXT] else h * factor
            return status, h, attempts
        if status == at.NOT_FINITE or (status != at.MOVING and h <= INSTANT):
            return status, h, attempts
        if status == at.MOVING and h <= least:
            pace[im.NEXT] = 2.0 * h
            return plain(surface, parcel, work, now, h), h, attempts
        factor = min(0.5, max(0.1, 0.8 * (allowed / error) ** (1.0 / 3.0)))
        h = max(h * factor, least if status == at.MOVING else 0.5 * INSTANT)
        pace[im.NEXT] = h


@kernel
def step(surface, parcel, work, now, left, events):
    """Advance by at most ``left`` seconds and log changes of supports. Returns (status, seconds)."""
    y, pace, ctl = parcel.y, work.pace, parcel.ctl
    for k in range(6):
        work.begin[k] = y[k]
    before = remember(parcel, work)
    attempts = 1
    if pace[im.FIXED] > 0.0:
        # equal steps up to where a state is asked for, none longer than said
        h = left / max(1.0, -((1e-9 - left / pace[im.FIXED]) // 1.0))
        status, _ = attempt(surface, parcel, work, now, h)
    else:
        status, h, attempts = controlled(surface, parcel, work, now, left)
    ctl[at.N_STEPS] += attempts
    if status == at.NOT_FINITE:
        for k in range(6):
            y[k] = work.begin[k]
    if status != at.MOVING:
        return status, 0.0
    changes = note_changes(parcel, work, before, now + h, events)
    pace[im.CROWD] = pace[im.CROWD] * exp(-h / SOON) + changes
    return status, h


@kernel
def advance(surface, parcel, work, stop, span, times, out, events):
    """Move one parcel by ``span`` seconds with the wheel velocities given.

    Args:
        surface: ``plant.kernels.common.surface.Surface``: the cells and their wheels.
        parcel: ``plant.kernels.common.parcels.Parcel``: footprint, constants and state; changed in place.
        work: ``plant.solvers.implicit.ImplicitWorkspace``: law and pace of the parcel, and scratch.
        stop: ``(1,)``: the call ends early once it is not 0; see ``plant.stop``.
        span: s; 0 only finds the loads and whether the parcel stands.
        times: ``(k,)`` s in ``(0, span]``, ascending: when states are asked for on the way; steps end there.
        out: ``(k, 6)``: those states.
        events: ``(capacity, 4)``: log.

    Returns:
        Seconds moved: ``span``, or less where the parcel tipped, the motion is unstable or the call was to end
        (``ctl[STATUS]``).
    """
    y, ctl, found = parcel.y, parcel.ctl, work.table[3]
    now, sampled, taken, steps = 0.0, 0, ctl[at.N_STEPS], work.pace[im.STEPS_LEFT :]
    steps[0] = min(steps[0], steps[1])
    ctl[at.N_LOGGED] = 0
    for k in range(6):
        work.begin[k] = y[k]
    # the wheels' speeds are new: so is the parcel's
    ctl[at.STATUS] = checked_velocity(surface, parcel, work, now, found)
    if span > 0.0 and ctl[at.STATUS] == at.MOVING:
        for k in range(3):
            y[at.UX + k] = found[k]
    while now < span and ctl[at.STATUS] == at.MOVING:
        ctl[at.STATUS] = may_go_on(stop, ctl[at.N_STEPS] - taken, steps, now)
        if ctl[at.STATUS] != at.MOVING:
            break
        target = times[sampled] if sampled < times.shape[0] else span
        status, h = step(surface, parcel, work, now, target - now, events)
        ctl[at.STATUS] = status
        now = target if h >= target - now else now + h
        sampled = sampled_until(now, y, times, sampled, out)
    steps[0] += steps[1] * now - (ctl[at.N_STEPS] - taken)
    fill(y, times, sampled, out)
    return now
