"""The event-driven loop of one parcel: step, find the earliest events, apply them as one change, go on."""

from __future__ import annotations

from math import cos, exp, inf, isfinite, sin

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.branches import branch_changes, underside
from plant.kernels.common.capture import groups_hold, join_last, try_capture
from plant.kernels.common.changes import apply, log
from plant.kernels.common.cone_hooks import cone_changes
from plant.kernels.common.events import bend, entering, leaving
from plant.kernels.common.footprint import fill, may_go_on
from plant.kernels.common.load_events import loading
from plant.kernels.common.modes import settled
from plant.kernels.common.motion import onto_surfaces, surface_rates
from plant.kernels.common.roots import horner
from plant.kernels.common.series import taylor
from plant.kernels.common.sliding_validity import outrunning, watch
from plant.kernels.common.springs import foreseen, ramp_ends
from plant.kernels.common.wheel_direction import next_turn

UNIT_TIME = (at.S_X, at.S_Y, at.S_TH, at.S_UX, at.S_UY, at.S_OM, at.S_C, at.S_S, at.S_E1, at.S_E2)
"""The series that events are read from, ..."""
UNIT_TIME_OF_MODE = (at.M_A0, at.M_BX, at.M_BY)
"""... and those of every mode."""
LOOK_AHEAD = 2.0
"""How far a step looks, over the mean time between events."""
DECAYED = 1e-22
"""A motor transient this small moves nothing any more."""
SHORTEST = 1e-7
"""Never look less far than this, s: many events at one instant would shrink the look, and time, to nothing."""
INSTANT = 1e-9
"""Changes that follow each other faster than this, s, ..."""
CROWD = 60
"""... so many times in a row, and four for every cell under the parcel, chase each other on the spot: cells on several
edges at once that no set settles. The set then stands for ``dwell`` seconds whatever happens: chatter of the amplitude
that ``capture_m`` allows."""
AFTER_DWELL = 4
"""Changes in a row after which it stands for that long again, unless time has moved on. Chatter that is slow in time,
but so frequent that half the allowance is gone, is treated alike, where the parcel is slow enough."""


@kernel
def to_unit_time(ser, order, groups, step):
    """Scale the series that events are read from, so that the step is one unit of time."""
    scale = 1.0
    for k in range(1, order + 1):
        scale *= step
        for row in UNIT_TIME:
            ser[row, k] *= scale
        for h in range(groups):
            ser[at.S_SHARE + (1 << h), k] *= scale
        for m in range(1 << groups):
            for row in UNIT_TIME_OF_MODE:
                ser[at.MODES_AT + m * at.MODE_ROWS + row, k] *= scale


@kernel
def sample(ser, order, y, t, out):
    """State at unit time ``t`` of the step that starts at ``y``."""
    out[0] = y[0] + horner(ser[at.S_X], order, t)
    out[1] = y[1] + horner(ser[at.S_Y], order, t)
    out[at.THETA] = y[at.THETA] + horner(ser[at.S_TH], order, t)
    out[at.UX] = horner(ser[at.S_UX], order, t)
    out[at.UY] = horner(ser[at.S_UY], order, t)
    out[at.OMEGA] = horner(ser[at.S_OM], order, t)


@kernel
def slope(g, order, t):
    """Derivative of a polynomial at ``t``."""
    value = 0.0
    for k in range(order, 0, -1):
        value = value * t + k * g[k]
    return value


@kernel
def drifted(grp, groups, y, c, s, zero):
    """True where a captured parcel has strayed from its surfaces by more than rounding."""
    for h in range(groups):
        value, rate, _ = surface_rates(grp[h], y, c, s, 0.0, 0.0, 0.0)
        if abs(value) > zero or abs(rate) > zero:
            return True
    return False


@kernel
def prepare(surface, parcel, work, now, e, events):
    """Captured groups, loads and accelerations at the start of a step. Returns the parcel's status."""
    ctl, y = parcel.ctl, parcel.y
    c, s = cos(y[at.THETA]), sin(y[at.THETA])
    if ctl[at.N_GROUPS] > 0:
        groups_hold(surface, parcel, c, s)
    if ctl[at.N_CROSSED] > 0 and (
        try_capture(surface, parcel, work, e, c, s)
        or (join_last(surface, parcel, work, c, s) and try_capture(surface, parcel, work, e, c, s))
    ):
        log(events, ctl, now, at.CAPTURE_BEGINS, work.cells[0], work.edges[0])
    status = settled(surface, parcel, work, e, c, s)
    groups = ctl[at.N_GROUPS]
    if status == at.MOVING and groups > 0 and drifted(work.grp, groups, y, c, s, parcel.par[at.ON_SURFACE]):
        onto_surfaces(parcel, work, c, s)
        status = settled(surface, parcel, work, e, cos(y[at.THETA]), sin(y[at.THETA]))
    return status


@kernel
def search(surface, parcel, work, order, step):
    """All events of the step that may be its earliest. Returns (how many, time of the earliest or 1)."""
    mem, ctl, par, ser, found = parcel.mem, parcel.ctl, parcel.par, work.ser, work.found
    centre, lever = bend(ser, order)
    count, end = leaving(surface, parcel, work, order, centre, lever, 1.0, at.ZERO)
    for i in range(ctl[at.N_MEMBERS]):
        work.where[mem[i, at.CELL]] = 1
    count, end = entering(surface, parcel, work, order, centre, lever, end, count)
    for i in range(ctl[at.N_MEMBERS]):
        work.where[mem[i, at.CELL]] = 0
    count, end = ramp_ends(surface, parcel, work, order, centre, lever, end, count)
    if foreseen(surface):
        count, end = loading(surface, parcel, work, order, end, count)
    limited, along = par[at.LIMIT] < inf, par[at.PUSH_PER_SHARE] != 0.0
    if limited or along:
        underside(ser, order, step)
    if limited:
        count, end = branch_changes(surface, parcel, work, order, end, count)
    count, end = cone_changes(work, surface, parcel, order, step, end, count)
    if along:
        count, end = outrunning(surface, parcel, work, order, end, count)
    earliest = 1.0
    for i in range(count):
        earliest = min(earliest, found[i, at.EV_TIME])
    return count, earliest


@kernel
def finite(y):
    """True where every entry of the state is a number."""
    for k in range(6):
        if not isfinite(y[k]):
            return False
    return True


@kernel
def move(work, order, y, t, step):
    """Take the state to unit time ``t``; keep the accelerations there, before any event, in ``work.before``.

    Returns whether every entry of the state is a number; where one isn't, ``y`` stays what it was.
    """
    ser, before = work.ser, work.before
    before[0] = slope(ser[at.S_UX], order, t) / step
    before[1] = slope(ser[at.S_UY], order, t) / step
    before[2] = slope(ser[at.S_OM], order, t) / step
    sample(ser, order, y, t, work.state)
    if not finite(work.state):
        return False
    for k in range(6):
        y[k] = work.state[k]
    return True


@kernel
def dwell(ser, y, par):
    """How long chatter may overrun its surface before it is missed by about ``capture_m`` (series in seconds).

    Returns (that time, s; whether the parcel as a whole is slow enough, or other cells' edges would be overrun too).
    """
    pull = abs(ser[at.S_UX, 1]) + abs(ser[at.S_UY, 1]) + par[at.RADIUS] * abs(ser[at.S_OM, 1])
    speed = abs(y[at.UX]) + abs(y[at.UY]) + par[at.RADIUS] * abs(y[at.OMEGA])
    small = 2.0 * par[at.CAPTURE] * pull
    return max((2.0 * par[at.CAPTURE] / (pull + 1e-300)) ** 0.5, SHORTEST), speed * speed < 100.0 * small


@kernel
def advance(surface, parcel, work, stop, span, budget, steps, times, out, events):
    """Move one parcel by ``span`` seconds with the wheel velocities given.

    Args:
        surface: ``plant.kernels.common.surface.Surface``: the cells and their wheels.
        parcel: ``plant.kernels.common.parcels.Parcel``: footprint, constants and state; changed in place.
        work: ``plant.solvers.exact.ExactWorkspace``: scratch.
        stop: ``(1,)``: the call ends early once it is not 0; see ``plant.stop``.
        span: s; 0 only finds the loads and whether the parcel stands.
        budget: events allowed in this call before the motion is called unstable.
        steps: ``(2,)`` steps allowed: at once, and more for each second reached.
        times: ``(k,)`` s in ``(0, span]``, ascending: when states are asked for on the way.
        out: ``(k, 6)``: those states.
        events: ``(capacity, 4)``: log.

    Returns:
        Seconds moved: ``span``, or less where the parcel tipped, the motion is unstable or the call was to end
        (``ctl[STATUS]``).
    """
    y, ctl, par, ser = parcel.y, parcel.ctl, parcel.par, work.ser
    now, sampled, used, instant, changed = 0.0, 0, 0, 0, False
    taken = ctl[at.N_STEPS]
    ctl[at.N_LOGGED] = ctl[at.N_CROSSED] = ctl[at.N_LAST] = 0
    if span == 0.0:
        ctl[at.STATUS] = prepare(surface, parcel, work, 0.0, 1.0, events)
    while now < span and ctl[at.STATUS] == at.MOVING:
        ctl[at.STATUS] = may_go_on(stop, ctl[at.N_STEPS] - taken, steps, now)
        if ctl[at.STATUS] != at.MOVING:
            break
        e = exp(-par[at.RATE] * now) if par[at.RATE] > 0.0 else 0.0
        if e < DECAYED:
            e = 0.0
        status = prepare(surface, parcel, work, now, e, events)
        ctl[at.N_CROSSED] = 0
        if status != at.MOVING:
            ctl[at.STATUS] = status
            if status == at.TIPPED:
                log(events, ctl, now, at.TIP, ctl[at.TIP_A], ctl[at.TIP_B])
            break
        # looking much farther than the next event costs order and finds roots that are thrown away
        crowd = CROWD + 4 * ctl[at.N_MEMBERS]
        stuck = instant >= crowd
        hurried = changed and 2 * used > budget
        ahead = span - now if stuck or hurried else min(span - now, LOOK_AHEAD * par[at.GAP])
        if par[at.PUSH_PER_SHARE] != 0.0:
            watch(surface, parcel, now, e, events)
            ahead = min(ahead, next_turn(surface, parcel, e))
        order, step = taylor(parcel, work, e, cos(y[at.THETA]), sin(y[at.THETA]), ahead)
        ctl[at.N_STEPS] += 1
        calm, slow = dwell(ser, y, par)
        to_unit_time(ser, order, ctl[at.N_GROUPS], step)
        if stuck or (hurried and slow):
            count, earliest, instant = 0, min(1.0, calm / step), min(instant, crowd - AFTER_DWELL)
            used += 1
            ctl[at.N_CHANGES] += 1
            ctl[at.N_CAPTURES] += 1
        else:
            count, earliest = search(surface, parcel, work, order, step)
        ends_at = now + earliest * step
        if earliest == 1.0 and step == span - now:
            ends_at = span
        while sampled < times.shape[0] and times[sampled] <= ends_at:
            sample(ser, order, y, (times[sampled] - now) / step, out[sampled])
            sampled += 1
        par[at.GAP] += 0.3 * (earliest * step - par[at.GAP]) if count > 0 else par[at.GAP]
        par[at.GAP] = max(par[at.GAP], SHORTEST)
        if not move(work, order, y, earliest, step) or (ends_at == now and count == 0):
            ctl[at.STATUS] = at.NOT_FINITE
            break
        now = ends_at
        changed = count > 0
        if changed:
            # events that rounding can't tell apart happen together
            together = earliest * (1.0 + 1e-13) + 1e-15
            apply(surface, parcel, work, count, together, now, events, cos(y[at.THETA]), sin(y[at.THETA]))
            if earliest * step > INSTANT:
                instant = 0
            instant += 1
            if instant <= crowd - AFTER_DWELL:
                used += 1
                ctl[at.N_CHANGES] += 1
        if used > budget:
            ctl[at.STATUS] = at.TOO_MANY_EVENTS
            ctl[at.CULPRIT] = int(work.found[0, at.EV_CELL])
    fill(y, times, sampled, out)
    return now
