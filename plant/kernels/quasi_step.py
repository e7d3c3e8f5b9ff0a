"""The velocity at which all pulls balance: the least dissipation potential, whatever the inertia.

Where a direction is left open, by a plateau of the potential or because nothing pulls along it, the velocity there is
the one nearest to the last: a proximal step, the minimum of ``|w - last|^2 / 2 + h sum phi_i(r_i(w))`` that
``implicit_step`` finds, with an h so long that inertia counts for nothing, and again from there until nothing moves.
"""

from __future__ import annotations

from plant.kernels import implicit_layout as im
from plant.kernels import layout as at
from plant.kernels.implicit_advance import decay, find_loads
from plant.kernels.implicit_step import grasp, new_velocity
from plant.kernels.jit import kernel

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
        resistance += row[im.B]
        limit += row[im.C]
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
