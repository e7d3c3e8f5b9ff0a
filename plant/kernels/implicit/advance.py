"""The implicit solver's loop of one parcel: steps, and what changed.

Controlled steps end at the first change of supports in them (``located``). Steps of a given length take the supports of
the pose that they begin at: there, cells enter and leave, loads vanish and return, at the ends of steps.
"""

from __future__ import annotations

from math import exp

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.advance import finite
from plant.kernels.common.footprint import fill, may_go_on, sampled_until
from plant.kernels.common.step_end import allowed, strike
from plant.kernels.implicit import located
from plant.kernels.implicit.extrapolation import cut
from plant.kernels.implicit.hooks import keep
from plant.kernels.implicit.step_events import note_changes, note_outrun, remember
from plant.kernels.implicit.stiction_hooks import keep_grips
from plant.kernels.implicit.supports import admit, decay, find_loads

SOON = 0.05
"""Support changes are forgotten after this time, s, where they are counted as chatter."""


@kernel
def unlocated_step(surface, parcel, work, now, left, events):
    """One step of the given length, at most ``left`` seconds, and what it changed. Returns (status, seconds)."""
    pace = work.pace
    for k in range(6):
        work.begin[k] = parcel.y[k]
    keep(work)
    keep_grips(surface, parcel, work, decay(parcel.par, now))
    before = remember(parcel, work)
    # equal steps up to where a state is asked for, none longer than said
    most = allowed(surface, parcel, work, now, pace[im.FIXED])
    h = left / max(1.0, -((1e-9 - left / most) // 1.0))
    status = cut(surface, parcel, work, now, h, im.ONE_PART)
    if status == at.MOVING and not finite(parcel.y):
        status = at.NOT_FINITE
    if status != at.MOVING:
        if status != at.TIPPED:
            # where it was when numbers ended, not where they led
            for k in range(6):
                parcel.y[k] = work.begin[k]
        return status, 0.0
    status = find_loads(surface, parcel, work)
    if status == at.MOVING:
        strike(surface, parcel, work, now, h)
    changes = note_changes(parcel, work, before, now + h, events)
    pace[im.CROWD] = pace[im.CROWD] * exp(-h / SOON) + changes
    if work.law[im.PUSH_PER_SHARE] != 0.0:
        note_outrun(surface, parcel, work, now + h, decay(parcel.par, now + h), events)
    return status, h


@kernel
def prepare_step(surface, parcel, work, now, events):
    """Loads where a call begins. Returns the status."""
    if work.pace[im.LOCATES] == 0.0:
        return find_loads(surface, parcel, work)
    return located.prepare(surface, parcel, work, now, events)


@kernel
def take_step(surface, parcel, work, now, left, events):
    """One step of at most ``left`` seconds. Returns (status, seconds, attempts)."""
    if work.pace[im.LOCATES] == 0.0:
        status, h = unlocated_step(surface, parcel, work, now, left, events)
        return status, h, at.ONE
    return located.step(surface, parcel, work, now, left, events)


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
    y, ctl, steps = parcel.y, parcel.ctl, work.pace[im.STEPS_LEFT :]
    now, sampled, taken = 0.0, 0, ctl[at.N_STEPS]
    steps[0] = min(steps[0], steps[1])
    ctl[at.N_LOGGED] = ctl[at.N_CROSSED] = ctl[at.N_LAST] = 0
    if work.pace[im.LOCATES] != 0.0:
        admit(surface, parcel, work)
    if span == 0.0 or work.pace[im.LOCATES] == 0.0:
        ctl[at.STATUS] = prepare_step(surface, parcel, work, now, events)
    while now < span and ctl[at.STATUS] == at.MOVING:
        ctl[at.STATUS] = may_go_on(stop, ctl[at.N_STEPS] - taken, steps, now)
        if ctl[at.STATUS] != at.MOVING:
            break
        target = times[sampled] if sampled < times.shape[0] else span
        status, h, tries = take_step(surface, parcel, work, now, target - now, events)
        ctl[at.N_STEPS] += tries
        now = target if h >= target - now else now + h
        ctl[at.STATUS] = status
        sampled = sampled_until(now, y, times, sampled, out)
    steps[0] += steps[1] * now - (ctl[at.N_STEPS] - taken)
    fill(y, times, sampled, out)
    return now
