"""Many parcels in one call of the quasi-static solver's kernel, one after another."""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.parcels import LOG_CAPACITY
from plant.kernels.common.record_pointer import pointer_to
from plant.kernels.common.select import load_state, note_result, parcel_view, store_state
from plant.kernels.common.springs import surface_under
from plant.kernels.quasi.advance import advance


@kernel
def advance_block(surface, parcels, work, stop, laws, paces, block, span, times, out, events, report):
    """Move the parcels of ``block`` by ``span`` seconds, as many as the log is sure to have room for.

    All as for ``plant.kernels.implicit.block.advance_block``, but that ``work`` is a
    ``plant.solvers.implicit.ImplicitWorkspace``.
    """
    surface, parcels, work = pointer_to(surface), pointer_to(parcels), pointer_to(work)
    used, noted = at.ZERO, at.ZERO
    for n in range(block.shape[0]):
        if used + LOG_CAPACITY > events.shape[0]:
            return n, noted
        i = block[n]
        parcel = pointer_to(parcel_view(parcels, i))
        changes = parcel.ctl[at.N_EVENTS]
        load_state(work, laws, paces, i)
        log = events[used : used + LOG_CAPACITY]
        here = pointer_to(surface_under(surface, i))
        moved = advance(here, parcel, work, stop, span, times, out[:, i], log)
        store_state(work, paces, i)
        noted, logged = note_result(parcel.ctl, i, moved, changes, report, noted)
        used += logged
    return block.shape[0], noted
