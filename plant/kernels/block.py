"""Many parcels in one call of the exact solver's kernel, one after another."""

from __future__ import annotations

from typing import Final

from plant.kernels import layout as at
from plant.kernels.advance import advance
from plant.kernels.jit import kernel
from plant.kernels.parcels import LOG_CAPACITY
from plant.kernels.pick import note_news, parcel_of

# ── allowance: float64 (m, ALLOWANCE_SIZE), changes of supports before a motion counts as unstable
LEFT: Final = 0  # of what was allowed so far
PER_SECOND: Final = 1
ALLOWANCE_SIZE: Final = 2


@kernel
def advance_block(surface, parcels, work, allowance, block, span, times, out, events, report):
    """Move the parcels of ``block`` by ``span`` seconds, as many as the log is sure to have room for.

    Allowances are buckets that fill with simulated time and hold one second's worth, so that chatter spread over many
    short calls is bounded like chatter in a long one.

    Args:
        surface: ``plant.kernels.surface.Surface``: the cells and their wheels.
        parcels: ``plant.kernels.parcels.Parcels``: all there are; those of the block are changed in place.
        work: ``plant.solvers.exact.Work``: scratch.
        allowance: ``(m, ALLOWANCE_SIZE)``; changed in place.
        block: ``(b,)`` which parcels.
        span: s; 0 only finds the loads and whether the parcels stand.
        times: ``(k,)`` s in ``(0, span]``, ascending: when states are asked for on the way.
        out: ``(k, m, 6)``: those states.
        events: ``(rows, 4)``: log, at least ``LOG_CAPACITY`` rows.
        report: ``(b, REPORT_SIZE)``: see ``plant.kernels.parcels``.

    Returns:
        How many of the block were moved, and to how many of these something happened.
    """
    used, noted = at.ZERO, at.ZERO
    for n in range(block.shape[0]):
        if used + LOG_CAPACITY > events.shape[0]:
            return n, noted
        i = block[n]
        parcel, refill = parcel_of(parcels, i), allowance[i, PER_SECOND]
        spent, changes = parcel.ctl[at.N_CHANGES], parcel.ctl[at.N_EVENTS]
        budget = min(allowance[i, LEFT], refill) + refill * span
        log = events[used : used + LOG_CAPACITY]
        moved = advance(surface, parcel, work, span, int(budget), times, out[:, i], log)
        allowance[i, LEFT] = budget - (parcel.ctl[at.N_CHANGES] - spent)
        noted, logged = note_news(parcel.ctl, i, moved, changes, report, noted)
        used += logged
    return block.shape[0], noted
