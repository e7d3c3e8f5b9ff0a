"""Many parcels in one call of the exact solver's kernel, one after another."""

from __future__ import annotations

from typing import Final

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.advance import advance
from plant.kernels.common.parcels import LOG_CAPACITY
from plant.kernels.common.record_pointer import pointer_to
from plant.kernels.common.select import note_result, parcel_view
from plant.kernels.exact.segments import (
    change,
    collect_changes,
    decay_wheels,
    local_surface,
    restore_wheels,
    sample_sensors,
    shift_log,
    until,
    within,
)

# ── allowance: float64 (m, ALLOWANCE_SIZE), changes of supports, and steps, before a motion is given up
LEFT: Final = 0  # of the changes allowed so far
PER_SECOND: Final = 1
STEPS_LEFT: Final = 2  # the same of steps
STEPS_PER_SECOND: Final = 3
ALLOWANCE_SIZE: Final = 4


@kernel
def advance_one(surface, parcel, work, stop, allowance, i, span, times, out, log):
    """Move parcel ``i`` by ``span`` seconds; see `advance_block`. Returns how far it came, s.

    Allowances are buckets that fill with simulated time and hold one second's worth, so that chatter spread over many
    short calls is bounded like chatter in a long one.
    """
    refill, spent, taken = allowance[i, PER_SECOND], parcel.ctl[at.N_CHANGES], parcel.ctl[at.N_STEPS]
    budget, steps = min(allowance[i, LEFT], refill) + refill * span, allowance[i, STEPS_LEFT:]
    steps[0] = min(steps[0], steps[1])
    moved = advance(surface, parcel, work, stop, span, int(budget), steps, times, out, log)
    allowance[i, LEFT] = budget - (parcel.ctl[at.N_CHANGES] - spent)
    steps[0] += steps[1] * moved - (parcel.ctl[at.N_STEPS] - taken)
    return moved


@kernel
def advance_block(surface, parcels, work, stop, allowance, block, span, times, out, events, report):
    """Move the parcels of ``block`` by ``span`` seconds, as many as the log is sure to have room for.

    Args:
        surface: ``plant.kernels.common.surface.Surface``: the cells and their wheels.
        parcels: ``plant.kernels.common.parcels.Parcels``: all there are; those of the block are changed in place.
        work: ``plant.solvers.exact.ExactWorkspace``: scratch.
        stop: ``(1,)``: the call ends early once it is not 0; see ``plant.stop``.
        allowance: ``(m, ALLOWANCE_SIZE)``; changed in place.
        block: ``(b,)`` which parcels.
        span: s; 0 only finds the loads and whether the parcels stand.
        times: ``(k,)`` s in ``(0, span]``, ascending: when states are asked for on the way.
        out: ``(k, m, 6)``: those states.
        events: ``(rows, 4)``: log, at least ``LOG_CAPACITY`` rows.
        report: ``(b, REPORT_SIZE)``: see ``plant.kernels.common.parcels``.

    Returns:
        How many of the block were moved, and to how many of these something happened.
    """
    surface, parcels, work = pointer_to(surface), pointer_to(parcels), pointer_to(work)
    used, noted = at.ZERO, at.ZERO
    for n in range(block.shape[0]):
        if used + LOG_CAPACITY > events.shape[0]:
            return n, noted
        i = block[n]
        parcel = pointer_to(parcel_view(parcels, i))
        changes = parcel.ctl[at.N_EVENTS]
        log = events[used : used + LOG_CAPACITY]
        moved = advance_one(surface, parcel, work, stop, allowance, i, span, times, out[:, i], log)
        noted, logged = note_result(parcel.ctl, i, moved, changes, report, noted)
        used += logged
    return block.shape[0], noted


@kernel
def advance_segmented(surface, parcels, work, stop, allowance, block, span, schedule, hand, events, report):
    """Move the parcels of ``block`` by ``span`` seconds on wheels that change on the way, each through its own legs.

    Args:
        surface: as for `advance_block`; the wheels as they are at the start.
        parcels: likewise.
        work: likewise.
        stop: likewise.
        allowance: likewise.
        block: likewise.
        span: likewise.
        schedule: ``plant.kernels.exact.segments.CallSchedule``: what happens on it.
        hand: ``plant.kernels.exact.segments.SegmentWorkspace``: scratch.
        events: as for `advance_block`.
        report: likewise.

    Returns:
        As `advance_block`.
    """
    surface, parcels, work = pointer_to(surface), pointer_to(parcels), pointer_to(work)
    used, noted = at.ZERO, at.ZERO
    for n in range(block.shape[0]):
        if used + LOG_CAPACITY > events.shape[0]:
            return n, noted
        i = block[n]
        parcel = pointer_to(parcel_view(parcels, i))
        events_before = parcel.ctl[at.N_EVENTS]
        log = events[used : used + LOG_CAPACITY]
        near = within(surface, schedule, parcel, i)
        changes, reads = collect_changes(surface, schedule, hand, near)
        here = pointer_to(local_surface(surface, hand))
        now, moved, logged, done, seen = 0.0, 0.0, at.ZERO, at.ZERO, at.ZERO
        while now < span and parcel.ctl[at.STATUS] == at.MOVING:
            done = change(schedule, hand, now, done, changes)
            end, before = hand.when[done] if done < changes else span, seen
            seen = until(hand, now, end, seen, reads)
            times, out, rest = hand.times[before:seen], hand.poses[before:seen, 0], log[logged:]
            moved = now + advance_one(here, parcel, work, stop, allowance, i, end - now, times, out, rest)
            logged = shift_log(log, parcel.ctl, logged, now)
            decay_wheels(surface, hand, near, parcel.par[at.RATE], end - now)
            now = end
        parcel.ctl[at.N_LOGGED] = logged
        sample_sensors(surface, schedule, hand, parcel, reads, seen)
        restore_wheels(surface, hand, near)
        noted, listed = note_result(parcel.ctl, i, moved, events_before, report, noted)
        used += listed
    return block.shape[0], noted
