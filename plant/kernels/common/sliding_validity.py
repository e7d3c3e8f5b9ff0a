"""Validity limit of the sliding law, in which every wheel outruns the parcel (eq. 24): located, and reported once.

The first outrun wheel is watched from then on. When the parcel has fallen behind this wheel again and outruns no other,
the next outrun wheel is a new report.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.branches import carries, slip_now, slip_polynomial
from plant.kernels.common.changes import log
from plant.kernels.common.events import crossing, note
from plant.kernels.common.roots import NONE
from plant.kernels.common.wheel_direction import direction

STILL = 1e-12
"""A speed, m/s, that is none: what rounding leaves of a parcel's motion across wheels that stand is no motion."""


@kernel
def excess(surface, parcel, e, cell, axis):
    """By how much the underside is faster than a wheel, along it, and how much of that is none, m/s.

    Beside a wheel that stands any motion is faster.
    """
    slip, zero = slip_now(surface, parcel.y, 1.0, e, cell, axis)
    way = direction(surface.steady[cell, axis], surface.decay[cell, axis], e)
    return abs(slip) if way == 0.0 else -way * slip, zero + STILL


@kernel
def watch(surface, parcel, now, e, events):
    """Keep which wheel is outrun, the first of them, in ``ctl``, and log where that begins."""
    ctl, before = parcel.ctl, parcel.ctl[at.OUTRUN]
    ctl[at.OUTRUN] = 0
    for i in range(ctl[at.N_MEMBERS]):
        cell = parcel.mem[i, at.CELL]
        if surface.grip[cell] == 0.0 or not carries(parcel, i):
            continue
        for axis in range(2):
            faster, zero = excess(surface, parcel, e, cell, axis)
            if faster > zero and ctl[at.OUTRUN] == 0:
                ctl[at.OUTRUN] = 1 + 2 * cell + axis
                if before == 0:
                    log(events, ctl, now, at.OUTRAN, cell, at.NO_CELL)


@kernel
def overtaking(surface, parcel, work, order, cell, axis, end):
    """Find when the parcel outruns a wheel by more than rounding, or falls behind an outrun wheel; or ``NONE``."""
    g, e, watched, first = work.g, work.ser[at.S_EXP, 0], parcel.ctl[at.OUTRUN] != 0, NONE
    way = direction(surface.steady[cell, axis], surface.decay[cell, axis], e)
    if watched and way == 0.0:
        # it no longer moves over a wheel that stands: only for an instant, where it turns back
        return first
    _, zero = slip_now(surface, parcel.y, 1.0, e, cell, axis)
    for side in (-1, 1):
        if side * way < 0.0:
            continue
        slip_polynomial(surface, parcel.y, 1.0, work.ser, order, cell, axis, g)
        for k in range(order + 1):
            g[k] *= -side if watched else side
        g[0] += 0.0 if watched else 2.0 * (zero + STILL)
        first = min(first, crossing(g, order, 0.0, end, work.p))
    return first


@kernel
def outrunning(surface, parcel, work, order, end, count):
    """The first wheel of the step that is outrun or, where one was, when that one no longer is: ends the step."""
    mem, ctl, watched = parcel.mem, parcel.ctl, parcel.ctl[at.OUTRUN] - 1
    culprit = at.NO_CELL
    for i in range(ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        if surface.grip[cell] == 0.0 or not carries(parcel, i):
            continue
        for axis in range(2):
            if watched < 0 or watched == 2 * cell + axis:
                t = overtaking(surface, parcel, work, order, cell, axis, end)
                if t <= end:
                    end, culprit = t, cell
    if culprit >= 0:
        count = note(work.found, count, end, at.SWITCH, culprit, at.ZERO)
    return count, end
