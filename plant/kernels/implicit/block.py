"""Many parcels in one call of the implicit solver's kernel, one after another."""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.parcels import LOG_CAPACITY
from plant.kernels.common.record_pointer import pointer_to
from plant.kernels.common.select import load_state, note_result, parcel_view, store_state
from plant.kernels.common.springs import surface_under
from plant.kernels.implicit.advance import advance
from plant.kernels.implicit.hooks import full, hand_over


@kernel
def advance_block(surface, parcels, work, stop, laws, paces, block, span, times, out, events, report):
    """Move the parcels of ``block`` by ``span`` seconds, as many as the log is sure to have room for.

    Args:
        surface: ``plant.kernels.common.surface.Surface``: the cells and their wheels.
        parcels: ``plant.kernels.common.parcels.Parcels``: all there are; those of the block are changed in place.
        work: ``plant.solvers.implicit.ImplicitWorkspace``: scratch, into which each parcel's law and pace are copied.
        stop: ``(1,)``: the call ends early once it is not 0; see ``plant.stop``.
        laws: ``(m, LAW_SIZE)``: each parcel's law; see ``plant.kernels.common.implicit_layout``.
        paces: ``(m, PACE_SIZE)``: settings and memory of each parcel's steps; changed in place.
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
        if used + LOG_CAPACITY > events.shape[0] or full(work):
            return n, noted
        i = block[n]
        parcel = pointer_to(parcel_view(parcels, i))
        changes = parcel.ctl[at.N_EVENTS]
        load_state(work, laws, paces, i)
        log = events[used : used + LOG_CAPACITY]
        here = pointer_to(surface_under(surface, i))
        moved = advance(here, parcel, work, stop, span, times, out[:, i], log)
        hand_over(work, parcel, span - moved)
        store_state(work, paces, i)
        noted, logged = note_result(parcel.ctl, i, moved, changes, report, noted)
        used += logged
    return block.shape[0], noted
