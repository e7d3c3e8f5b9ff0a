"""Cells whose two wheels share one limit (``isotropic``): where their slip ends within a step.

The slip is a vector. Its size falls to zero in finite time, and only there does the force jump; a slip that merely
passes zero turns round within a time in proportion to the least size that it has. Neither motion can be led on smoothly
beyond. Steps therefore end where a slip ends, none passes one whose size dips to a tenth of what it has at both ends of
the step, and none lets a slip turn by more than 60 degrees in one of its parts.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.branches import lever, pulls, slight, slip_polynomial, underside
from plant.kernels.common.cone_hooks import cone_changes
from plant.kernels.common.events import crossing, note
from plant.kernels.common.hooks import implements
from plant.kernels.common.lag_hooks import add_lag, with_lag_rate
from plant.kernels.common.roots import NONE
from plant.kernels.implicit.hooks import slip_left
from plant.kernels.implicit.step import LARGEST, rounded_slip, wheel_slip

DIP = 0.1
"""A slip that is smaller than this share of what it is at both ends of a step nearly ends within."""
TURN = 0.5
"""Cosine of the angle by which a slip may turn in a part of a step."""
LEFT = 1e-2
"""A slip is all but ended where it is this small, over a tolerance in m and per second: steps leave as much."""
NEAR = 0.3
"""A slip that would come this near to its end, over what it is now, by its present rate is stepped up to there only."""


@kernel
def slip_rate(surface, parcel, work, acceleration, e, cell, axis):
    """How fast a wheel's slip changes, m/s^2; ``e`` is the motors' decay factor."""
    y, par = parcel.y, parcel.par
    rate = with_lag_rate(work, cell, axis, -par[at.RATE] * e * par[at.FREE_SPEED] * surface.decay[cell, axis])
    rate -= acceleration[axis] + lever(surface, y, cell, axis) * acceleration[2]
    # the lever changes as the centre of mass moves
    return rate + y[at.OMEGA] * (y[at.UX] if axis == 1 else -y[at.UY])


@kernel
def cone_rate(surface, parcel, work, acceleration, e, cell):
    """How fast the size of the slip of a cell's wheels changes, m/s^2; below zero where there is no slip."""
    x, _ = wheel_slip(surface, parcel, work, e, cell, 0)
    y, _ = wheel_slip(surface, parcel, work, e, cell, 1)
    size = (x * x + y * y) ** 0.5
    if size == 0.0:
        return -1.0
    rate = x * slip_rate(surface, parcel, work, acceleration, e, cell, 0)
    return (rate + y * slip_rate(surface, parcel, work, acceleration, e, cell, 1)) / size


@kernel
def end_ahead(size, before, earlier):
    """In how many parts a slip of this ``size`` ends, by a parabola through its size one and two parts before.

    Returns (that, at most 1; how much it then falls in a part).
    """
    fall, bend = before - size, size - 2.0 * before + earlier
    if not fall > 0.0:
        return 0.5, size
    # of the two ways to write a root, the one that does not cancel
    slope = fall - 0.5 * bend
    root = slope * slope - 2.0 * bend * size
    below = slope + root**0.5 if root > 0.0 else slope
    ahead = 2.0 * size / below if below > 0.0 else 0.5
    return min(ahead, 1.0), fall


@kernel
def note_end(first, row, size):
    """Keep where in the last part a slip ends that was of this ``size`` as the part began."""
    ahead, fall = end_ahead(size, row[im.ONE_BEFORE], row[im.TWO_BEFORE])
    first[im.ENDS] = min(first[im.ENDS], ahead)
    first[im.LED_ON] = max(first[im.LED_ON], 0.5 * fall * (1.0 - ahead) * (1.0 - ahead))


@kernel
def watch_cones(parcel, work, count, part, last):
    """Note slips that end, or turn by more than ``TURN``, by the end of the ``part`` just solved of the finest cut.

    ``last`` is its last part.
    """
    first = work.first
    for i in range(count):
        row = work.wheels[i]
        if row[im.SLIPS] == 0.0:
            continue
        x, y = slip_left(work, row, work.velocity, 0), slip_left(work, row, work.velocity, 1)
        was_x, was_y = row[im.WAS_X], row[im.WAS_Y]
        size, before = (x * x + y * y) ** 0.5, (was_x * was_x + was_y * was_y) ** 0.5
        if size <= rounded_slip(row, work.velocity):
            # what the error of the step before left ends at once where other wheels hold the parcel
            if before > parcel.par[at.TOLERANCE]:
                first[im.CEASED] = min(first[im.CEASED], part + 1.0)
            if part == last:
                note_end(first, row, before)
        elif (
            min(size, before) > LARGEST * slight(parcel.par, 0.0)
            and x * was_x + y * was_y < TURN * size * before
        ):
            first[im.TURNED] = 1.0
        row[im.TWO_BEFORE], row[im.ONE_BEFORE] = row[im.ONE_BEFORE], before


@kernel
def until_cones_end(surface, parcel, work, e, h):
    """How long a step of at most ``h`` may be that passes the end of no slip, as far as its present rate tells.

    ``e`` is the motors' decay factor now.
    """
    if work.law[im.LOCATED] != im.CONES:
        return h
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if parcel.mem[i, at.BRANCH] == 0 or not pulls(surface, parcel, i):
            continue
        cell = parcel.mem[i, at.CELL]
        x, _ = wheel_slip(surface, parcel, work, e, cell, 0)
        y, _ = wheel_slip(surface, parcel, work, e, cell, 1)
        ax = slip_rate(surface, parcel, work, work.begun, e, cell, 0)
        ay = slip_rate(surface, parcel, work, work.begun, e, cell, 1)
        along, fall, across = -(x * ax + y * ay), ax * ax + ay * ay, x * ay - y * ax
        if (x * x + y * y) ** 0.5 <= LEFT * parcel.par[at.TOLERANCE]:
            continue
        if along > 0.0 and across * across <= NEAR * NEAR * (x * x + y * y) * fall and along < h * fall:
            h = along / fall
    return h


@kernel
def cone_change(surface, parcel, work, order, cell, end):
    """Find when the slip of a cell, along what it is as the step begins, is all but ended, or ``NONE``."""
    par, ser, g, q = parcel.par, work.ser, work.g, work.q
    slip_polynomial(surface, parcel.y, par[at.FREE_SPEED], ser, order, cell, 0, g)
    slip_polynomial(surface, parcel.y, par[at.FREE_SPEED], ser, order, cell, 1, q)
    add_lag(work, cell, 0, order, g)
    add_lag(work, cell, 1, order, q)
    size = (g[0] * g[0] + q[0] * q[0]) ** 0.5
    if size <= LEFT * par[at.TOLERANCE]:
        return NONE
    x, y = g[0] / size, q[0] / size
    last_x = last_y = 0.0
    for k in range(order + 1):
        last_x += g[k]
        last_y += q[k]
        g[k] = x * g[k] + y * q[k]
    last = (last_x * last_x + last_y * last_y) ** 0.5
    g[0] -= max(slight(par, 0.0), DIP * min(size, last))
    return crossing(g, order, 0.0, end, work.p)


@implements(cone_changes, "law", own=True)
def _cone_changes(work, surface, parcel, order, step, end, count):
    if work.law[im.LOCATED] != im.CONES:
        return count, end
    underside(work.ser, order, step)
    culprit = at.NO_CELL
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if parcel.mem[i, at.BRANCH] != 0 and pulls(surface, parcel, i):
            t = cone_change(surface, parcel, work, order, parcel.mem[i, at.CELL], end)
            if t <= end:
                end, culprit = t, parcel.mem[i, at.CELL]
    if culprit >= 0:
        count = note(work.found, count, end, at.SWITCH, culprit, at.ZERO)
    return count, end
