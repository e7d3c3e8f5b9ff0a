"""A controlled step that ends at its first event: a change of supports, of the branch of the law at a wheel, tipping.

The supports, and the branches where they are located, are held over the step, so that the motion is smooth wherever it
leads. Its events are isolated as roots on the step's series (``dense``), as the exact solver isolates its own. The step
is then taken again up to the first of them, and moved on by what is left to it, which is far below the tolerance.
"""

from __future__ import annotations

from math import cos, inf, sin

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.advance import (
    AFTER_DWELL,
    CROWD,
    DECAYED,
    INSTANT,
    LOOK_AHEAD,
    finite,
    move,
    search,
    slope,
    to_unit_time,
)
from plant.kernels.common.advance import SHORTEST as SHORTEST_LOOK
from plant.kernels.common.advance import prepare as capture_and_settle
from plant.kernels.common.branches import settle_branches
from plant.kernels.common.capture import depth, edge_motion, slot_of
from plant.kernels.common.changes import apply
from plant.kernels.common.hooks import implements
from plant.kernels.common.modes import least_share
from plant.kernels.common.series import taylor
from plant.kernels.common.sliding_validity import watch
from plant.kernels.common.springs import (
    foreseen,
    gap,
    inset,
    negligible,
    note_gaps,
    plane_at,
    ramps,
    reach,
    smooth,
)
from plant.kernels.common.step_end import allowed, strike
from plant.kernels.common.wheel_direction import next_turn
from plant.kernels.implicit.cones import until_cones_end
from plant.kernels.implicit.dense import expand
from plant.kernels.implicit.event_hooks import UNCAPTURED, follow_captures
from plant.kernels.implicit.extrapolation import SHORTEST, controlled, extrapolated, tolerated
from plant.kernels.implicit.hooks import begin_lags, carry_lags, expand_lags, keep, note_lag_slopes, take_back
from plant.kernels.implicit.sliding import accelerate_along, by_series, until_a_side_ends
from plant.kernels.implicit.slips import (
    commit_slips,
    end_slips,
    give_way,
    rest_slips,
    settle_slips,
    slip_motion,
    until_one_slips,
)
from plant.kernels.implicit.step import slips_jump
from plant.kernels.implicit.step_events import note_changes, note_outrun, remember
from plant.kernels.implicit.stiction_hooks import keep_grips, restore_grips
from plant.kernels.implicit.supports import (
    carry_supports,
    corner_speed,
    decay,
    longest,
    note_centroid,
    settle_loads,
)

TRAVEL = 1.0
"""Pitches that a corner may move in a step: no event is looked for farther ahead."""
TURN = 0.5
"""Angle that a parcel may turn in a step, rad: the series of sine and cosine stay short."""
LATE = 1e-11
"""A change of branch is passed by this time, s: the force is continuous there, and no step need end before it again."""
CORRECTED = 0.05
"""A step is moved on to its event by no more than this share of it."""
CORRECTIONS = 4
TRIFLE = 1e-3
"""A share of the tolerance by which a parcel may be put aside."""


@kernel
def prepare(surface, parcel, work, now, events):
    """Loads, and branches of the law, where a step begins. Returns the status."""
    status = prepare_supports(surface, parcel, work, now, events)
    if status == at.MOVING:
        note_centroid(work)
    return status


@kernel
def prepare_uncaptured(surface, parcel, work, now):
    """Loads, and branches of the law. Returns the status."""
    status = settle_loads(surface, parcel, work, at.NOTHING)
    if status == at.MOVING and work.law[im.LOCATED] != 0.0:
        if slips_jump(work.law):
            settle_slips(surface, parcel, work, decay(parcel.par, now))
        else:
            settle_branches(surface, parcel, work.seg, at.ZERO, decay(parcel.par, now))
    return status


@kernel
def prepare_mixed(surface, parcel, work, now, e, events):
    """As ``prepare_supports``, where captured motion is stepped. Returns the status."""
    work.pace[im.NOW] = now
    if work.law[im.LOCATED] != 0.0:
        settle_slips(surface, parcel, work, e)
    return capture_and_settle(surface, parcel, work, now, e, events)


@kernel
def prepare_supports(surface, parcel, work, now, events):
    """Loads, and what is captured. Returns the status."""
    if work.law[im.CAPTURES] == 0.0:
        return prepare_uncaptured(surface, parcel, work, now)
    e = decay(parcel.par, now)
    e = e if e >= DECAYED else 0.0
    if by_series(work):
        return capture_and_settle(surface, parcel, work, now, e, events)
    return prepare_mixed(surface, parcel, work, now, e, events)


@kernel
def note_outrun_wheels(surface, parcel, work, now, events):
    """Log where a law that takes every wheel to outrun the parcel begins not to hold: located where steps end there."""
    e = decay(parcel.par, now)
    if parcel.par[at.PUSH_PER_SHARE] != 0.0:
        watch(surface, parcel, now, e if e >= DECAYED else 0.0, events)
    elif work.law[im.PUSH_PER_SHARE] != 0.0:
        note_outrun(surface, parcel, work, now, e, events)


@kernel
def look_ahead(surface, parcel, work, now, left):
    """How long a step may be at most, s."""
    y, par = parcel.y, parcel.par
    e = decay(par, now)
    h = min(longest(par, now, left), work.pace[im.NEXT])
    turning, speed = abs(y[at.OMEGA]), corner_speed(parcel)
    way = 2.0 * reach(surface) if ramps(surface, parcel) else TRAVEL * par[at.PITCH]
    if speed * h > way:
        h = way / speed
    if turning * h > TURN:
        h = TURN / turning
    if par[at.PUSH_PER_SHARE] != 0.0:
        h = min(h, next_turn(surface, parcel, e))
    if e >= DECAYED and (par[at.PUSH_PER_SHARE] != 0.0 or par[at.LIMIT] < inf):
        h = min(h, 1.0 / par[at.RATE])
    return allowed(surface, parcel, work, now, h)


@kernel
def find_events(surface, parcel, work, now, h):
    """Events of the step just taken, from ``work.begin`` to where the parcel is. Returns (how many, the first's time).

    Times are in steps. Leaves the parcel where the step began, and where it ends in ``work.end``.
    """
    y = parcel.y
    accelerate_along(surface, parcel, work, now + h, work.ended)
    for k in range(6):
        work.end[k], y[k] = y[k], work.begin[k]
    carry_supports(parcel, work)
    order = expand(surface, parcel, work, now, h, cos(y[at.THETA]), sin(y[at.THETA]))
    expand_lags(work, h)
    count, first = search(surface, parcel, work, order, im.UNITY)
    for i in range(count):
        # of cells that are overlooked at one edge, not captured
        if work.found[i, at.EV_KIND] == at.CORNER and parcel.ctl[at.N_GROUPS] == 0:
            work.found[i, at.EV_KIND] = at.LEAVE
    for k in range(3):
        work.before[k] = slope(work.ser[at.S_UX + k], order, first) / h
    note_lag_slopes(work, first, h)
    return count, first


@kernel
def first_event(work, count, first):
    """Row of the earliest event found, a crossing of the footprint's edge before other kinds."""
    which = at.NO_CELL
    for i in range(count):
        kind = work.found[i, at.EV_KIND]
        if work.found[i, at.EV_TIME] <= first and (which < 0 or kind == at.ENTER or kind == at.LEAVE):
            which = i
    return which


@kernel
def event_motion(surface, parcel, work, kind, cell, edge, now, t):
    """Value and rate, where the parcel is, of the function whose root an event is; (0, 0) where it has none.

    ``t`` seconds into the step that begins ``now``; ``edge`` is the axis of a wheel that changes branch.
    """
    y = parcel.y
    c, s = cos(y[at.THETA]), sin(y[at.THETA])
    if kind == at.ENTER or kind == at.LEAVE or kind == at.CORNER:
        rate, _ = edge_motion(surface.pos, parcel.normal, cell, edge, y, c, s, work.before)
        return depth(surface, parcel, cell, edge, c, s) - inset(surface), rate
    if kind == at.RAMP:
        rate, _ = edge_motion(surface.pos, parcel.normal, cell, edge, y, c, s, work.before)
        return depth(surface, parcel, cell, edge, c, s) - reach(surface), rate
    if kind == at.UNLOAD or kind == at.TOUCH:
        # the last entry says in which mode
        seg = work.segs[edge]
        if parcel.ctl[at.N_GROUPS] > 0:
            note_gaps(surface, parcel, seg, at.MARK + edge)
        a0, bx, by = plane_at(surface, seg, -seg[at.CX], -seg[at.CY])
        rx, ry = surface.pos[cell, 0] - y[0] - seg[at.CX], surface.pos[cell, 1] - y[1] - seg[at.CY]
        load = a0 + bx * rx + by * ry - gap(surface, cell)
        past = 2.0 * negligible(surface, a0)
        rate = (seg[at.PXX] * y[at.UX] + seg[at.PXY] * y[at.UY]) * rx
        rate += (seg[at.PXY] * y[at.UX] + seg[at.PYY] * y[at.UY]) * ry
        return (load + past if kind == at.UNLOAD else load - past), rate
    if kind == at.SWITCH and slips_jump(work.law):
        return slip_motion(surface, parcel, work, now, t, cell, edge)
    return 0.0, 0.0


@kernel
def move_on(surface, parcel, work, which, most, now, t, left):
    """Move the parcel to the event ``which``, by no more than ``most`` either way. Returns the time that took, s.

    It is ``t`` seconds into the step that begins ``now``. At the end of the call, ``left`` seconds ahead, the event has
    come as near as rounding allows.
    """
    y, a, found, moved = parcel.y, work.before, work.found, 0.0
    if which < 0:
        return moved
    kind, cell = int(found[which, at.EV_KIND]), int(found[which, at.EV_CELL])
    edge = int(found[which, at.EV_EDGE])
    for _ in range(CORRECTIONS):
        carry_supports(parcel, work)
        value, rate = event_motion(surface, parcel, work, kind, cell, edge, now, t + moved)
        dt = min(-value / rate if rate != 0.0 else 0.0, left - moved)
        if not abs(dt) <= most or dt == 0.0:
            break
        for k in range(3):
            y[k] += dt * (y[at.UX + k] + 0.5 * dt * a[k])
            y[at.UX + k] += dt * a[k]
        carry_lags(work, dt)
        moved += dt
    if kind == at.ENTER or kind == at.LEAVE:
        onto_edge(surface, parcel, cell, edge, TRIFLE * parcel.par[at.TOLERANCE])
    return moved


@kernel
def onto_edge(surface, parcel, cell, edge, most):
    """Shift the parcel by no more than ``most`` so that a cell lies on an edge, where it is not there to rounding.

    A step too short to be ended at its event leaves it beside, and the cell would cross the edge to and fro.
    """
    y, par, normal = parcel.y, parcel.par, parcel.normal
    c, s = cos(y[at.THETA]), sin(y[at.THETA])
    off = depth(surface, parcel, cell, edge, c, s) - inset(surface)
    if 0.25 * par[at.ON_SURFACE] < abs(off) <= max(most, 4.0 * par[at.ON_SURFACE]):
        y[0] -= off * (c * normal[edge, 0] - s * normal[edge, 1])
        y[1] -= off * (s * normal[edge, 0] + c * normal[edge, 1])


@kernel
def take_to(surface, parcel, work, now, h, count, first, left):
    """Take the step from ``work.begin`` again, up to the first of its events. Returns (status, seconds)."""
    y = parcel.y
    which = first_event(work, count, first)
    t = first * h
    if which >= 0 and work.found[which, at.EV_KIND] == at.SWITCH and not slips_jump(work.law):
        t = min(t + LATE, h)
    if t == 0.0:
        take_back(work)
        restore_grips(surface, work)
        return at.MOVING, 0.0
    status, _ = extrapolated(surface, parcel, work, now, t)
    if status == at.MOVING and not finite(y):
        status = at.NOT_FINITE
    if status != at.MOVING:
        return status, t
    t += move_on(surface, parcel, work, which, CORRECTED * t, now, t, left - t)
    return status, t


@kernel
def captured_step(surface, parcel, work, now, left, events):
    """One step along captured surfaces, as the exact solver takes it. Returns (status, seconds, attempts)."""
    y, par, ser = parcel.y, parcel.par, work.ser
    e = decay(par, now)
    ahead = min(left, LOOK_AHEAD * par[at.GAP])
    if par[at.PUSH_PER_SHARE] != 0.0:
        ahead = min(ahead, next_turn(surface, parcel, e))
    order, h = taylor(parcel, work, e if e >= DECAYED else 0.0, cos(y[at.THETA]), sin(y[at.THETA]), ahead)
    to_unit_time(ser, order, parcel.ctl[at.N_GROUPS], h)
    count, first = search(surface, parcel, work, order, h)
    par[at.GAP] += 0.3 * (first * h - par[at.GAP]) if count > 0 else par[at.GAP]
    par[at.GAP] = max(par[at.GAP], SHORTEST_LOOK)
    if not move(work, order, y, first, h):
        return at.NOT_FINITE, 0.0, at.ONE
    if count > 0:
        together = first * (1.0 + 1e-13) + 1e-15
        apply(
            surface,
            parcel,
            work,
            count,
            together,
            now + first * h,
            events,
            cos(y[at.THETA]),
            sin(y[at.THETA]),
        )
    return at.MOVING, first * h, at.ONE


@implements(follow_captures, *UNCAPTURED, own=True)
def _nothing_captured(_surface, _parcel, _work, _now, _left, _events):
    return at.MOVING, 0.0, at.ZERO


@implements(follow_captures, *UNCAPTURED, own=False)
def _along_captures(surface, parcel, work, now, left, events):
    if parcel.ctl[at.N_GROUPS] == 0 or not by_series(work):
        return at.MOVING, 0.0, at.ZERO
    return captured_step(surface, parcel, work, now, left, events)


@kernel
def calm(surface, parcel, work):
    """How long the cells that crossed an edge last may overrun it, s: 0 unless they swing by less than ``capture_m``.

    The way over is ``capture_m`` at most, by the accelerations before.
    """
    c, s = cos(parcel.y[at.THETA]), sin(parcel.y[at.THETA])
    bound, fastest = 2.0 * parcel.par[at.CAPTURE], 0.0
    for i in range(parcel.ctl[at.N_CROSSED]):
        rate, second = edge_motion(
            surface.pos, parcel.normal, work.cells[i], work.edges[i], parcel.y, c, s, work.before
        )
        if rate * rate >= bound * abs(second):
            return 0.0
        fastest = max(fastest, abs(second))
    return (bound / fastest) ** 0.5 if fastest > 0.0 else 0.0


@kernel
def overlook(parcel, work, crossed, side):
    """Have the cells that crossed last overlooked at the edges that they crossed (``side`` 1), or no longer (0)."""
    for i in range(crossed):
        slot = slot_of(parcel.mem, parcel.ctl, work.cells[i])
        if slot < 0:
            work.where[work.cells[i]] = side
        else:
            parcel.mem[slot, at.SIDE], parcel.mem[slot, at.EDGE] = side, work.edges[i]


@kernel
def dwell(parcel, work):
    """How long no change is looked for, s, where changes at one instant can't be settled: ``capture_m`` is overrun."""
    a, par = work.before, parcel.par
    pull = abs(a[0]) + abs(a[1]) + par[at.RADIUS] * abs(a[2])
    return max((2.0 * par[at.CAPTURE] / (pull + 1e-300)) ** 0.5, SHORTEST_LOOK)


@kernel
def unsettled(parcel, work):
    """Whether changes have followed each other at one instant for so long that no set of supports settles them."""
    return work.pace[im.CROWD] >= CROWD + 4 * parcel.ctl[at.N_MEMBERS]


@kernel
def rough(surface, parcel, work, h):
    """Whether a step that was accepted is not right to the tolerance now that it has been shortened to ``h``.

    Only where loads ramp: a ramp that ends within a part of the longer step looks like a jump as the step begins, and
    the error of that step told nothing of the shorter one's.
    """
    return smooth(surface) and h > SHORTEST and work.first[im.ERROR] > tolerated(parcel, work, h)


@kernel
def step(surface, parcel, work, now, left, events):
    """One step of at most ``left`` seconds, to its first event. Returns (status, seconds, attempts)."""
    y, pace, ctl = parcel.y, work.pace, parcel.ctl
    slips = slips_jump(work.law)
    # nothing chatters where loads ramp
    chatters = work.law[im.CAPTURES] == 0.0 and not smooth(surface)
    quiet = calm(surface, parcel, work) if chatters else 0.0
    blind = unsettled(parcel, work)
    if blind:
        quiet = dwell(parcel, work)
        pace[im.CROWD] -= AFTER_DWELL
    crossed = ctl[at.N_CROSSED] if quiet > 0.0 and ctl[at.N_GROUPS] == 0 else at.ZERO
    status = prepare(surface, parcel, work, now, events)
    ctl[at.N_CROSSED] = 0
    if status != at.MOVING:
        return status, 0.0, at.ONE
    note_outrun_wheels(surface, parcel, work, now, events)
    status, h, attempts = follow_captures(surface, parcel, work, now, left, events)
    if attempts > 0:
        return status, h, attempts
    if quiet > 0.0:
        left = min(left, quiet)
        ctl[at.N_CAPTURES] += 1
    for k in range(6):
        work.begin[k] = y[k]
    keep(work)
    keep_grips(surface, parcel, work, decay(parcel.par, now))
    before = remember(parcel, work) if not foreseen(surface) else at.ZERO
    status = accelerate_along(surface, parcel, work, now, work.begun)
    while slips and give_way(surface, parcel, work):
        # a wheel that slips may pull with less than it held, and others give way in turn
        status = accelerate_along(surface, parcel, work, now, work.begun)
    if status == at.TIPPED:
        return status, 0.0, at.ONE
    begin_lags(work)
    share, _, _ = least_share(parcel, work)
    most = until_cones_end(
        surface, parcel, work, decay(parcel.par, now), look_ahead(surface, parcel, work, now, left)
    )
    while True:
        status, h, more = controlled(surface, parcel, work, now, most)
        attempts += more
        if status == at.MOVING and not finite(y):
            status = at.NOT_FINITE
        if status == at.MOVING and ctl[at.N_GROUPS] > 0:
            status, h, more = until_a_side_ends(surface, parcel, work, now, h, share)
            attempts += more
        if status == at.MOVING and slips:
            status, h, more = until_one_slips(surface, parcel, work, now, h)
            attempts += more
        if status != at.MOVING:
            break
        if rough(surface, parcel, work, h):
            most = h
            continue
        overlook(parcel, work, crossed, at.ONE)
        count, first = find_events(surface, parcel, work, now, h)
        overlook(parcel, work, crossed, at.ZERO)
        if blind:
            count = at.ZERO
        if count == 0:
            for k in range(6):
                y[k] = work.end[k]
            if slips:
                rest_slips(surface, parcel, work, now, h)
                commit_slips(surface, parcel, work)
            break
        most = first * h
        status, h = take_to(surface, parcel, work, now, h, count, first, left)
        attempts += 1
        if status != at.MOVING or not rough(surface, parcel, work, most):
            break
    if status != at.MOVING:
        if status != at.TIPPED:
            # where it was when numbers ended, not where they led
            for k in range(6):
                y[k] = work.begin[k]
        return status, 0.0, attempts
    carry_supports(parcel, work)
    if not foreseen(surface):
        # which cells carry load changes without a jump, and is looked at as the step ends
        status = settle_loads(surface, parcel, work, at.NOTHING)
        note_changes(parcel, work, before, now + h, events)
    strike(surface, parcel, work, now, h)
    if count > 0:
        together = first * (1.0 + 1e-13) + 1e-15
        c, s = cos(y[at.THETA]), sin(y[at.THETA])
        if slips:
            end_slips(surface, parcel, work, count, together, decay(parcel.par, now + h))
        apply(surface, parcel, work, count, together, now + h, events, c, s)
        pace[im.CROWD] = pace[im.CROWD] + 1.0 if h <= INSTANT else 0.0
    return status, h, attempts
