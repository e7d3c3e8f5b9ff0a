"""Supports of one parcel where it is: found afresh, or those of a step's begin carried to another pose of the step."""

from __future__ import annotations

from math import cos, exp, sin

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.changes import enter
from plant.kernels.common.footprint import box, inside
from plant.kernels.common.hooks import implements
from plant.kernels.common.loads import settle_mode
from plant.kernels.common.springs import reach, spread, touches, weigh

FARTHEST = 1e9
"""A parcel this many pitches away has no cells under it."""


def admit(surface, parcel, work):
    """Add the cells that are under the parcel by the width of their wheels alone, where a call begins."""


@kernel
def find_loads(surface, parcel, work):
    """Which cells lie under the parcel where it is, and which of them carry load. Returns the status."""
    y, par, mem, grid = parcel.y, parcel.par, parcel.mem, surface.grid
    count, slack = at.ZERO, par[at.ON_SURFACE] + reach(surface)
    margin = par[at.ON_SURFACE] + spread(surface, parcel.normal)
    away = max(abs(y[0] - par[at.ORIGIN_X]), abs(y[1] - par[at.ORIGIN_Y]))
    if away < FARTHEST * par[at.PITCH]:
        c, s = cos(y[at.THETA]), sin(y[at.THETA])
        first_row, last_row, first_column, last_column = box(parcel.vertices, y, par, grid, margin)
        for row in range(first_row, last_row + 1):
            for column in range(first_column, last_column + 1):
                cell = grid[row, column]
                if cell >= 0 and inside(
                    surface.pos[cell, 0], surface.pos[cell, 1], parcel.normal, parcel.offset, y, c, s, slack
                ):
                    mem[count, at.CELL], mem[count, at.MARK] = cell, at.ACTIVE
                    if touches(surface, parcel, count, c, s):
                        count += 1
    parcel.ctl[at.N_MEMBERS] = count
    return settle_loads(surface, parcel, work, at.NOTHING)


@implements(admit, "edges", own=False)
def _all_known(_surface, _parcel, _work):
    return


@implements(admit, "edges", own=True)
def _admit(surface, parcel, work):
    y, par, mem, ctl, grid, where = parcel.y, parcel.par, parcel.mem, parcel.ctl, surface.grid, work.where
    if max(abs(y[0] - par[at.ORIGIN_X]), abs(y[1] - par[at.ORIGIN_Y])) >= FARTHEST * par[at.PITCH]:
        return
    c, s = cos(y[at.THETA]), sin(y[at.THETA])
    # one whose wheel just touches an edge has left
    slack = reach(surface) - par[at.ON_SURFACE]
    margin = spread(surface, parcel.normal)
    first_row, last_row, first_column, last_column = box(parcel.vertices, y, par, grid, margin)
    for i in range(ctl[at.N_MEMBERS]):
        where[mem[i, at.CELL]] = 1
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            cell = grid[row, column]
            if cell < 0 or where[cell] != 0:
                continue
            px, py = surface.pos[cell, 0], surface.pos[cell, 1]
            if inside(px, py, parcel.normal, parcel.offset, y, c, s, slack):
                enter(mem, ctl, cell)
    for i in range(ctl[at.N_MEMBERS]):
        where[mem[i, at.CELL]] = 0


@kernel
def settle_loads(surface, parcel, work, ahead):
    """Which of the cells under the parcel carry load where it is, in every mode. Returns the status.

    Cells of which a share is under the parcel count by that ``ahead`` seconds from now.
    """
    weigh(surface, parcel, ahead)
    status = at.MOVING
    for m in range(1 << parcel.ctl[at.N_GROUPS]):
        status = settle_mode(surface, parcel, work, m)
        if status != at.MOVING:
            break
    return status


@kernel
def decay(par, time):
    """Compute the decay factor of the motors' transient after ``time``; 0 without motors."""
    return exp(-par[at.RATE] * time) if par[at.RATE] > 0.0 else 0.0


@kernel
def corner_speed(parcel):
    """Speed that no corner exceeds, m/s."""
    y = parcel.y
    along = y[at.UX] * y[at.UX] + y[at.UY] * y[at.UY]
    return along**0.5 + parcel.par[at.RADIUS] * abs(y[at.OMEGA])


@kernel
def note_centroid(work):
    """Keep where the centroid of each mode's supports is from the parcel at the begin of a step."""
    for m in range(work.segs.shape[0]):
        work.centroid[m, 0], work.centroid[m, 1] = work.segs[m, at.CX], work.segs[m, at.CY]


@kernel
def carry_supports(parcel, work):
    """Have the supports of the step's begin, at ``work.begin``, for those where the parcel is."""
    for m in range(1 << parcel.ctl[at.N_GROUPS]):
        work.segs[m, at.CX] = work.centroid[m, 0] + (work.begin[0] - parcel.y[0])
        work.segs[m, at.CY] = work.centroid[m, 1] + (work.begin[1] - parcel.y[1])


@kernel
def longest(par, now, left):
    """How long a step may be: no longer than the motors' transient, as long as it lasts, since it could pass unseen."""
    return min(left, max(1.0 / par[at.RATE], now)) if par[at.RATE] > 0.0 else left
