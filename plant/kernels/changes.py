"""Applying events: all that fall together are one change of the support set, in whatever order they were found."""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.capture import edge_of
from plant.kernels.jit import kernel
from plant.kernels.loads import drop, release


@kernel
def log(events, ctl, time, kind, cell, edge):
    """Log an event; past the log's end events are counted and not kept."""
    if ctl[at.N_LOGGED] < events.shape[0]:
        row = events[ctl[at.N_LOGGED]]
        row[at.EV_TIME], row[at.EV_KIND], row[at.EV_CELL], row[at.EV_EDGE] = time, kind, cell, edge
    ctl[at.N_LOGGED] += 1


@kernel
def slot_of(mem, ctl, cell):
    """Where a cell stands among the members, or -1."""
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.CELL] == cell:
            return i
    return -1


@kernel
def apply(surface, parcel, work, count, together, time, events, c, s):
    """Apply all events at or before ``together``, or too near to tell apart, as one change of the support set.

    The cells that crossed the footprint's edge are counted in ``ctl`` and left in ``work.cells``, with their edges in
    ``work.edges`` and +1 (entered) or -1 (left) in ``work.signs``.
    """
    found, cells, edges, mem, share, ctl = (
        work.found,
        work.cells,
        work.edges,
        parcel.mem,
        parcel.share,
        parcel.ctl,
    )
    crossed = at.ZERO
    for i in range(count):
        kind, cell = int(found[i, at.EV_KIND]), int(found[i, at.EV_CELL])
        edge, distance = at.ZERO, 1.0
        if kind in (at.ENTER, at.LEAVE):
            edge, distance = edge_of(surface.pos, parcel.normal, parcel.offset, cell, parcel.y, c, s)
        if found[i, at.EV_TIME] > together and distance > parcel.par[at.ON_SURFACE]:
            continue
        slot = slot_of(mem, ctl, cell)
        if kind == at.ENTER and slot < 0:
            slot = ctl[at.N_MEMBERS]
            ctl[at.N_MEMBERS] += 1
            mem[slot, at.CELL], mem[slot, at.MARK] = cell, at.ACTIVE
            share[slot, at.SHARE] = share[slot, at.BASE] = 0.0
        elif kind == at.LEAVE and slot >= 0 and mem[slot, at.MARK] != at.CAPTURED:
            drop(mem, share, ctl, slot)
        elif kind == at.UNLOAD and slot >= 0:
            mem[slot, at.MARK] = at.LIFTED
        elif kind == at.TOUCH and slot >= 0:
            mem[slot, at.MARK] = at.ACTIVE
        elif (
            kind in (at.FRACTION_ZERO, at.FRACTION_ONE, at.CORNER)
            and slot >= 0
            and mem[slot, at.MARK] == at.CAPTURED
        ):
            release(mem, share, ctl, mem[slot, at.GROUP], kind == at.FRACTION_ONE)
            ctl[at.N_CAPTURES] += 1
        else:
            continue
        log(events, ctl, time, kind, cell, int(found[i, at.EV_EDGE]))
        ctl[at.N_EVENTS] += 1
        if kind in (at.ENTER, at.LEAVE) and crossed < cells.shape[0]:
            cells[crossed] = cell
            edges[crossed] = edge
            work.signs[crossed] = 1 if kind == at.ENTER else -1
            crossed += 1
    ctl[at.N_CROSSED] = crossed
