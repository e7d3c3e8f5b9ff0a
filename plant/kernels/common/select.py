"""Selection of one parcel from the arrays of all, and reports of its changes."""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.parcels import CHANGES, LEFT_OUT, LOG_CAPACITY, LOGGED, MOVED, WHICH, Parcel


@kernel
def parcel_view(parcels, i):
    """Parcel ``i``: parts of the arrays of all, not copies."""
    corner, end = parcels.corner[i], parcels.corner[i + 1]
    return Parcel(
        parcels.vertices[corner:end],
        parcels.normal[corner:end],
        parcels.offset[corner:end],
        parcels.par[i],
        parcels.y[i],
        parcels.mem[parcels.slot[i] : parcels.slot[i + 1]],
        parcels.ctl[i],
    )


@kernel
def note_result(ctl, i, moved, changes, report, noted):
    """Report parcel ``i`` if anything happened to it; ``changes`` is how many there had been before the call.

    Returns (rows of the report in use, rows of the log that it took).
    """
    found = ctl[at.N_LOGGED]
    logged = min(found, LOG_CAPACITY)
    if ctl[at.STATUS] == at.MOVING and ctl[at.N_EVENTS] == changes and logged == 0:
        return noted, logged
    row = report[noted]
    row[WHICH], row[MOVED], row[CHANGES] = i, moved, ctl[at.N_EVENTS] - changes
    row[LOGGED], row[LEFT_OUT] = logged, found - logged
    return noted + 1, logged


@kernel
def load_state(work, laws, paces, i):
    """Copy law and pace of parcel ``i`` into a ``plant.solvers.implicit.ImplicitWorkspace``."""
    for k in range(im.LAW_SIZE):
        work.law[k] = laws[i, k]
    for k in range(im.PACE_SIZE):
        work.pace[k] = paces[i, k]


@kernel
def store_state(work, paces, i):
    """Copy the pace, as it has become, back."""
    for k in range(im.PACE_SIZE):
        paces[i, k] = work.pace[k]
