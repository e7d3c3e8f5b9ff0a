"""Applying events: all that fall together are one change of the support set, in whatever order they were found."""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.capture import edge_of, slot_of
from plant.kernels.common.modes import drop, release, release_inside


@kernel
def log(events, ctl, time, kind, cell, edge):
    """Log an event; past the log's end events are counted and not kept."""
    if ctl[at.N_LOGGED] < events.shape[0]:
        row = events[ctl[at.N_LOGGED]]
        row[at.EV_TIME], row[at.EV_KIND], row[at.EV_CELL], row[at.EV_EDGE] = time, kind, cell, edge
    ctl[at.N_LOGGED] += 1


@kernel
def enter(mem, ctl, cell):
    """Add a cell that carries load in every mode, its wheels within their limits, until ``modes`` says otherwise."""
    slot = ctl[at.N_MEMBERS]
    ctl[at.N_MEMBERS] += 1
    mem[slot, at.CELL], mem[slot, at.SIDE] = cell, 0
    for m in range(at.MODES):
        mem[slot, at.MARK + m] = at.ACTIVE
        mem[slot, at.BRANCH + 2 * m] = mem[slot, at.BRANCH + 2 * m + 1] = 0


@kernel
def apply(surface, parcel, work, count, together, time, events, c, s):
    """Apply all events at or before ``together``, or too near to tell apart, as one change of the support set.

    The cells that crossed the footprint's edge are counted in ``ctl`` and left in ``work.cells``, with their edges in
    ``work.edges`` and +1 (entered) or -1 (left) in ``work.signs``.
    """
    found, cells, edges, mem, ctl = work.found, work.cells, work.edges, parcel.mem, parcel.ctl
    crossed = at.ZERO
    for i in range(count):
        kind, cell = int(found[i, at.EV_KIND]), int(found[i, at.EV_CELL])
        if kind == at.SWITCH:
            # of a wheel: nothing about the supports
            continue
        edge, distance = at.ZERO, 1.0
        if kind in (at.ENTER, at.LEAVE):
            edge, distance = edge_of(surface.pos, parcel.normal, parcel.offset, cell, parcel.y, c, s)
        if found[i, at.EV_TIME] > together and distance > parcel.par[at.ON_SURFACE]:
            continue
        slot = slot_of(mem, ctl, cell)
        captured = slot >= 0 and mem[slot, at.SIDE] != 0
        if kind == at.ENTER and slot < 0:
            enter(mem, ctl, cell)
        elif kind == at.LEAVE and slot >= 0 and not captured:
            drop(mem, ctl, slot)
        elif kind in (at.UNLOAD, at.TOUCH) and slot >= 0:
            # the last entry says in which mode
            mem[slot, at.MARK + int(found[i, at.EV_EDGE])] = at.LIFTED if kind == at.UNLOAD else at.ACTIVE
        elif kind in (at.ONLY_NEAR, at.ONLY_FAR) and captured:
            release(surface, mem, ctl, mem[slot, at.GROUP], kind == at.ONLY_FAR)
            ctl[at.N_CAPTURES] += 1
        elif kind == at.CORNER and captured:
            release_inside(surface, mem, ctl, mem[slot, at.GROUP])
            ctl[at.N_CAPTURES] += 1
            slot = slot_of(mem, ctl, cell)
            if slot >= 0:
                drop(mem, ctl, slot)
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
    if crossed == 0:
        ctl[at.N_LAST] = 0
