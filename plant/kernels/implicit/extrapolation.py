"""Steps of one parcel between changes of its supports: implicit Euler's in 1 to 4 parts, extrapolated.

The step is taken in 1, 2, 3 and 4 parts and the four results are extrapolated to no step length at all. The cells under
the parcel are those of the step's begin all along, and as a rule so are those that carry load (``im.LOCATES``). Steps
of a given length, one part each, find both afresh.
"""

from __future__ import annotations

from math import cos, sin

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.advance import finite
from plant.kernels.common.motion import solve
from plant.kernels.common.springs import foreseen
from plant.kernels.implicit.balance_hooks import balance, begin_balance, hold_supports
from plant.kernels.implicit.cones import watch_cones
from plant.kernels.implicit.hooks import extrapolate, slow, tabulate, take_back
from plant.kernels.implicit.step import (
    EPSILON,
    INSTANT,
    ROUNDED,
    grasp,
    largest_slip,
    regime,
    slips_jump,
)
from plant.kernels.implicit.stiction_hooks import commit_grips, find_velocity, restore_grips
from plant.kernels.implicit.supports import decay, find_loads

PARTS = 4
"""Into how many parts a controlled step is cut at most."""
LASTS = 1.0
"""An error in velocity counts as the way it leads in this time, s."""
JUMP = 1e-3
"""A step however short may be wrong by this share of the tolerance: a jump of the force can't be had for less."""
SHORTEST = 1e-12
"""No step is shorter, s; at this length any is taken."""
TRIFLE = 1e-10
"""In a step this short, s, the forces are within rounding of the velocities: one not solved to rounding is as good."""
TRIFLING = 1e-2
"""Of the error that a step may have, this share may be due to a slip that was led on beyond its end."""
HURRIED = 16.0
"""A step in which a slip turns too far is shortened as if its error were so many times what it may be."""
MANY = 20.0
"""More support changes than this at once are chatter: steps across them need be no shorter than ..."""
FRACTION_STEPS = 24
FARTHEST = 1.0
"""Under ``wheel_load`` no trial fraction is farther than this from [0, 1]."""
CHORDS = 4
"""So many of them share the slopes of the first."""
NUDGE = 1e-2
"""A fraction is changed by as much, to see how the velocity answers."""
SHORT = 1e-4
"""... this, s, in which a parcel strays by some nanometres."""


@kernel
def supports_here(surface, parcel, work, part):
    """Find the loads for a ``part`` of a step from where the parcel is, its supports held if they are.

    Returns the status.
    """
    if work.pace[im.LOCATES] != 0.0:
        return hold_supports(surface, parcel, work, part)
    return find_loads(surface, parcel, work)


@kernel
def note_normals(surface, parcel, work, h):
    """How fast each captured surface is left, by velocity, where the present velocity leads in ``h``."""
    y, normals, arm = parcel.y, work.normals, work.pace[im.GYRATION]
    angle = y[at.THETA] + h * y[at.OMEGA]
    c, s = cos(angle), sin(angle)
    for g in range(parcel.ctl[at.N_GROUPS]):
        normals[g, 0] = normals[g, 1] = normals[g, 2] = 0.0
    for i in range(parcel.ctl[at.N_MEMBERS]):
        side, normal = parcel.mem[i, at.SIDE], normals[parcel.mem[i, at.GROUP]]
        if side != 0:
            cell, edge = parcel.mem[i, at.CELL], parcel.mem[i, at.EDGE]
            nx = c * parcel.normal[edge, 0] - s * parcel.normal[edge, 1]
            ny = s * parcel.normal[edge, 0] + c * parcel.normal[edge, 1]
            rx = y[0] + h * y[at.UX] - surface.pos[cell, 0]
            ry = y[1] + h * y[at.UY] - surface.pos[cell, 1]
            normal[0] += side * nx
            normal[1] += side * ny
            normal[2] += side * (nx * ry - ny * rx) / arm


@kernel
def leaving_rates(parcel, work, w, rates):
    """How fast the velocity ``w`` leaves each captured surface, into ``rates``. Returns the largest."""
    most = 0.0
    for g in range(parcel.ctl[at.N_GROUPS]):
        normal = work.normals[g]
        rates[g] = -(normal[0] * w[0] + normal[1] * w[1] + normal[2] * w[2])
        most = max(most, abs(rates[g]))
    return most


@kernel
def at_fractions(surface, parcel, work, e, h, w):
    """Velocity after a step of ``h`` at the present fractions. Returns (how many wheels pull, whether it was found)."""
    count = grasp(surface, parcel, work, work.law, e, h)
    return count, find_velocity(surface, parcel, work, count, h, w)


@kernel
def near(work, fraction):
    """Limit a trial fraction: the speed of loaded wheels would run away with the fraction."""
    return max(-FARTHEST, min(1.0 + FARTHEST, fraction)) if work.law[im.WHEEL] != 0.0 else fraction


@kernel
def find_motion(surface, parcel, work, e, h, w):
    """Velocity after a step of ``h`` into ``w``, and the fractions that leave it along captured surfaces.

    In an instant the fractions stay what they are. Returns (how many wheels pull, whether it was found).
    """
    count, found = at_fractions(surface, parcel, work, e, h, w)
    groups, fraction, rates = parcel.ctl[at.N_GROUPS], work.fraction, work.reply[3]
    if groups == 0 or h <= INSTANT or not found:
        return count, found
    note_normals(surface, parcel, work, h)
    size = abs(work.start[0]) + abs(work.start[1]) + abs(work.start[2])
    for i in range(count):
        size = max(size, work.wheels[i, im.SUMMED])
    for k in range(FRACTION_STEPS):
        off = leaving_rates(parcel, work, w, rates)
        if off <= ROUNDED * EPSILON * (size + abs(w[0]) + abs(w[1]) + abs(w[2])):
            break
        if k % CHORDS == 0:
            for g in range(groups):
                fraction[g] += NUDGE
                _, found = at_fractions(surface, parcel, work, e, h, w)
                fraction[g] -= NUDGE
                leaving_rates(parcel, work, w, work.change)
                for j in range(groups):
                    work.matrix[j, g] = (rates[j] - work.change[j]) / NUDGE
        if solve(work.matrix, groups, rates, work.change, work.scratch) == 0.0:
            break
        for g in range(groups):
            fraction[g] = near(work, fraction[g] + work.change[g])
        count, found = at_fractions(surface, parcel, work, e, h, w)
        if not found:
            break
    return count, found


@kernel
def outside(parcel, work):
    """How far a captured group's fraction is outside [0, 1]; 0 where none is."""
    most = 0.0
    for g in range(parcel.ctl[at.N_GROUPS]):
        most = max(most, -work.fraction[g], work.fraction[g] - 1.0)
    return most


@kernel
def euler(surface, parcel, work, until, h):
    """One implicit step of ``h`` that ends at ``until``, with the loads found last.

    Returns (status, the wheels' ``regime``, how many pull).
    """
    y, arm, start, w = parcel.y, work.pace[im.GYRATION], work.start, work.velocity
    start[0], start[1], start[2] = y[at.UX], y[at.UY], arm * y[at.OMEGA]
    begin_balance(surface)
    e = decay(parcel.par, until)
    while True:
        count, found = find_motion(surface, parcel, work, e, h, w)
        if not found:
            status = im.NOT_SOLVED
            break
        noise = 8.0 * EPSILON * (abs(w[0]) + abs(w[1]) + abs(start[0]) + abs(start[1])) / h
        ax, ay = (w[0] - start[0]) / h, (w[1] - start[1]) / h
        status = balance(surface, parcel, work, (e, h, w[0], w[1], w[2]), ax, ay, noise)
        if status != im.UNBALANCED:
            break
    if status == at.TIPPED:
        return status, 0.0, count
    # untouched where nothing pulls: scaling to and fro could cost its last digit
    turning = y[at.OMEGA] if w[2] == start[2] else w[2] / arm
    y[at.UX], y[at.UY], y[at.OMEGA] = w[0], w[1], turning
    y[0] += h * w[0]
    y[1] += h * w[1]
    y[at.THETA] += h * turning
    return status, regime(work, count, work.law[im.ISOTROPIC], w), count


@kernel
def branches(law):
    """Whether a law has branches: its force has a limit that some slip reaches."""
    return law[im.SET_VALUED] != 0.0 or (
        (law[im.LIMIT] < 1e300 and law[im.LIMIT_PER_SHARE] < 1e300)
        and (law[im.STIFFNESS] > 0.0 or law[im.STIFFNESS_PER_SHARE] > 0.0)
    )


@kernel
def note_branches(surface, parcel, work, now):
    """Keep which branch of the law each wheel is on now, and the acceleration, in ``work.begun``; the state stays."""
    y, end = parcel.y, work.end
    for k in range(6):
        end[k] = y[k]
    _, work.begun[3], _ = euler(surface, parcel, work, now + INSTANT, INSTANT)
    for k in range(3):
        work.begun[k] = (y[at.UX + k] - end[at.UX + k]) / INSTANT
    for k in range(6):
        y[k] = end[k]


@kernel
def cut(surface, parcel, work, now, h, parts):
    """Take a step from ``work.begin`` in equal parts, the loads found afresh for each. Returns the status."""
    y, part = parcel.y, h / parts
    for k in range(6):
        y[k] = work.begin[k]
    take_back(work)
    restore_grips(surface, work)
    work.first[im.SLIPPED] = work.first[im.OUTSIDE] = work.first[im.TURNED] = 0.0
    work.first[im.CEASED], work.first[im.ENDS], work.first[im.LED_ON] = parts + 1.0, 1.0, 0.0
    for j in range(parts):
        status = supports_here(surface, parcel, work, part)
        if status != at.MOVING:
            return status
        status, wheels, pulling = euler(surface, parcel, work, now + (j + 1) * part, part)
        slow(work, parcel, pulling, part)
        commit_grips(surface, work, pulling)
        if parts == PARTS and slips_jump(work.law):
            work.first[im.SLIPPED] = max(work.first[im.SLIPPED], largest_slip(work, pulling))
            watch_cones(parcel, work, pulling, j, PARTS - 1)
        if parts == PARTS:
            work.first[im.OUTSIDE] = max(work.first[im.OUTSIDE], outside(parcel, work))
        if j == 0:
            work.first[im.REGIME] = wheels
            for k in range(3):
                work.first[k] = y[at.UX + k] - work.begin[at.UX + k]
        if not finite(y):
            return at.NOT_FINITE
        if status == at.TIPPED or (status == im.NOT_SOLVED and part > TRIFLE):
            return status
    return at.MOVING


@kernel
def extrapolated(surface, parcel, work, now, h):
    """Take a step in 1 to 4 parts; the extrapolated state into ``parcel.y``. Returns (status, error in m)."""
    y, table, last = parcel.y, work.table, work.table[PARTS - 1]
    for parts in range(1, PARTS + 1):
        status = cut(surface, parcel, work, now, h, parts)
        if status != at.MOVING:
            return status, 1e300
        for k in range(6):
            table[parts - 1, k] = y[k]
        tabulate(work, parts - 1)
    for k in range(6):
        # differences from the last: where all agree to the bit, as they do of a parcel that sticks, so does the result
        one, two, three = table[0, k] - last[k], table[1, k] - last[k], table[2, k] - last[k]
        y[k] = last[k] - one / 6.0 + 4.0 * two - 13.5 * three
        work.error[k] = -one / 6.0 + 2.0 * two - 4.5 * three
    error = length(work.error, at.ZERO, parcel) + LASTS * length(work.error, at.UX, parcel)
    work.first[im.ERROR] = max(error, extrapolate(work, LASTS))
    return at.MOVING, work.first[im.ERROR]


@kernel
def length(state, first, parcel):
    """Size of a displacement or velocity at the footprint, given from entry ``first`` on."""
    along, turn = state[first] * state[first] + state[first + 1] * state[first + 1], abs(state[first + 2])
    return along**0.5 + parcel.par[at.RADIUS] * turn


@kernel
def unseen(surface, parcel, work, now, h):
    """Error, m, by a change in the first or last part of a step just taken, which extrapolation can't see.

    A change of the branch of the law at some wheel. The last part had no look at its end; one in the
    first part looks like one at the start, to every way of cutting the step. Estimated by the change of velocity in the
    first part, against that in one more part after the step's end, and against the acceleration of ``note_branches``.
    """
    y, part, error, first = parcel.y, h / PARTS, work.error, work.first
    status = supports_here(surface, parcel, work, part)
    if status != at.MOVING:
        return 0.0 if h <= INSTANT else 1e300
    for k in range(6):
        work.end[k] = y[k]
    _, wheels, _ = euler(surface, parcel, work, now + h + part, part)
    for k in range(3):
        error[at.UX + k] = (y[at.UX + k] - work.end[at.UX + k]) - first[k]
    for k in range(6):
        y[k] = work.end[k]
    wrong = 0.0
    if wheels != first[im.REGIME]:
        wrong = LASTS * length(error, at.UX, parcel)
    if first[im.REGIME] != work.begun[3]:
        for k in range(3):
            error[at.UX + k] = first[k] - part * work.begun[k]
        wrong = max(wrong, LASTS * length(error, at.UX, parcel))
    return wrong


@kernel
def tips_next(surface, parcel, work, now, h):
    """Whether the parcel tips in one more part after the step just taken: its last part had no look at its end."""
    y, part = parcel.y, h / PARTS
    for k in range(6):
        work.end[k] = y[k]
    status = supports_here(surface, parcel, work, part)
    if status == at.MOVING:
        status, _, _ = euler(surface, parcel, work, now + h + part, part)
    for k in range(6):
        y[k] = work.end[k]
    return status == at.TIPPED


@kernel
def tolerated(parcel, work, h):
    """The error, m, that a step of ``h`` may have."""
    return work.pace[im.TOLERANCE] * max(h, JUMP) + rounding(parcel.y)


@kernel
def controlled(surface, parcel, work, now, h):
    """One step of at most ``h`` that is right to the tolerance. Returns (status, seconds, attempts)."""
    pace, attempts = work.pace, at.ZERO
    watched = branches(work.law) and work.law[im.LOCATED] == 0.0
    if watched:
        note_branches(surface, parcel, work, now)
    while True:
        attempts += 1
        status, error = extrapolated(surface, parcel, work, now, h)
        allowed = tolerated(parcel, work, h)
        if status == at.MOVING and error <= allowed and watched:
            error = max(error, unseen(surface, parcel, work, now, h))
        if not foreseen(surface) and status == at.MOVING and error <= allowed and h > INSTANT:
            error = 1e300 if tips_next(surface, parcel, work, now, h) else error
        if status == at.MOVING and h > SHORTEST:
            if work.first[im.CEASED] < PARTS:
                # a slip that ends in the last part alone leaves the others as they are
                h *= work.first[im.CEASED] / PARTS
                continue
            if work.first[im.LED_ON] * h / PARTS > TRIFLING * allowed:
                # where all slips end at once, every way of cutting the step leads them on alike
                h *= (PARTS - 1.0 + work.first[im.ENDS]) / PARTS
                continue
            if work.first[im.TURNED] != 0.0:
                error = max(error, HURRIED * allowed)
        factor = 5.0 if error == 0.0 else min(5.0, max(0.1, 0.8 * (allowed / error) ** 0.25))
        if status == at.MOVING and error <= allowed:
            pace[im.NEXT] = max(pace[im.NEXT], h) if factor >= 1.0 and h < pace[im.NEXT] else h * factor
            return status, h, attempts
        if h <= SHORTEST or (h <= SHORT and pace[im.CROWD] > MANY):
            # what no step length smooths is taken as it is, by the plain step that never gains energy
            status = cut(surface, parcel, work, now, h, im.ONE_PART)
            if status != im.NOT_SOLVED:
                pace[im.NEXT] = 2.0 * h
                return status, h, attempts
        h = max(h * min(factor, 0.5), SHORTEST)
        pace[im.NEXT] = h


@kernel
def rounding(y):
    """Bound the rounding error of an extrapolated position, m. The weights of the extrapolation add up to about 20."""
    return 20.0 * EPSILON * (abs(y[0]) + abs(y[1]))
