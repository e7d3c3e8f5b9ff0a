"""Events at the end of a step: changed supports and wheel states, for solvers that check at step ends only."""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.changes import log
from plant.kernels.implicit.hooks import speed


@kernel
def remember(parcel, work):
    """Keep which cells are under the parcel, and which of them carry load."""
    for i in range(parcel.ctl[at.N_MEMBERS]):
        work.saved[i, 0], work.saved[i, 1] = parcel.mem[i, at.CELL], parcel.mem[i, at.MARK]
    return parcel.ctl[at.N_MEMBERS]


@kernel
def note_changes(parcel, work, before, now, events):
    """Log what is not as ``remember`` saved it. Returns how many changes."""
    mem, ctl, saved, where = parcel.mem, parcel.ctl, work.saved, work.where
    changes = at.ZERO
    for i in range(ctl[at.N_MEMBERS]):
        where[mem[i, at.CELL]] = 1 + mem[i, at.MARK]
    for i in range(before):
        cell, mark = saved[i, 0], where[saved[i, 0]] - 1
        if mark != saved[i, 1]:
            kind = at.LEAVE if mark < 0 else (at.UNLOAD if mark == at.LIFTED else at.TOUCH)
            log(events, ctl, now, kind, cell, at.NO_CELL)
            changes += 1
        where[cell] = 0
    for i in range(ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        if where[cell] != 0:
            log(events, ctl, now, at.ENTER, cell, at.NO_CELL)
            changes += 1
            where[cell] = 0
    ctl[at.N_EVENTS] += changes
    return changes


@kernel
def outran(velocity, speed):
    """Whether the underside is faster than a wheel in the wheel's own direction, or moves where the wheel stands."""
    zero = 1e-9 * abs(speed) + 1e-12
    return velocity * speed > (abs(speed) + zero) * abs(speed) or (speed == 0.0 and abs(velocity) > zero)


@kernel
def note_outrun(surface, parcel, work, now, e, events):
    """Log where a law that takes every wheel to outrun the parcel begins not to hold."""
    y, mem, ctl, pace = parcel.y, parcel.mem, parcel.ctl, work.pace
    first = at.NO_CELL
    for i in range(ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        if mem[i, at.MARK] == at.ACTIVE and surface.grip[cell] != 0.0 and first < 0:
            vx = y[at.UX] - y[at.OMEGA] * (surface.pos[cell, 1] - y[1])
            vy = y[at.UY] + y[at.OMEGA] * (surface.pos[cell, 0] - y[0])
            wheel_x, wheel_y = speed(work, surface, cell, e)
            if outran(vx, wheel_x) or outran(vy, wheel_y):
                first = cell
    if first >= 0 and pace[im.OUTRUN] == 0.0:
        log(events, ctl, now, at.OUTRAN, first, at.NO_CELL)
    pace[im.OUTRUN] = 1.0 if first >= 0 else 0.0
