"""The events of one step at the footprint's edge: cells that enter or leave it.

All series are in unit time here (coefficient k times step**k). A candidate whose distance from its surface exceeds
what the motion can cover in the step is passed over by that bound alone; the others are isolated as polynomials.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.roots import NONE, deflate, first_crossing, horner
from plant.kernels.common.springs import inset, spread

SLACK = 1e-6
"""How far past the earliest event so far, in unit time, others are still looked for: they may fall together."""


@kernel
def edge_polynomial(ser, order, nx, ny, offset, px, py, g):
    """Distance inside one edge of the cell at (px, py) from ``X0``: coefficients into ``g``."""
    along, across = nx * px + ny * py, nx * py - ny * px
    for k in range(order + 1):
        g[k] = -along * ser[at.S_C, k] - across * ser[at.S_S, k] + nx * ser[at.S_E1, k] + ny * ser[at.S_E2, k]
    g[0] += offset


@kernel
def crossing(g, order, zero, end, p):
    """Earliest fall of ``g`` below zero; 0.0 where the motion just after the start is below already."""
    degree = order
    if abs(g[0]) <= zero:
        degree, sign = deflate(g, order, zero)
        if sign == 0:
            return NONE
        if sign < 0:
            return 0.0
    elif g[0] < 0.0:
        # below by more than rounding: the crossing was at the start
        return 0.0
    return first_crossing(g, degree, end, p)


@kernel
def negate(g, order):
    """Turn ``g`` over, to look for a rise as a fall."""
    for k in range(order + 1):
        g[k] = -g[k]


@kernel
def entry(ser, order, normal, offset, outside, px, py, curve, zero, end, g, p, start):
    """Earliest time at which a cell outside the footprint is inside every edge. Returns (time, edge).

    Leaps from the last of the violated edges' crossings to the next until none is violated, so that no short stay
    is stepped over. A cell that rests on an edge for the whole step is inside of it, as members on an edge stay
    members; it doesn't enter by that edge, though. ``outside`` is ``inset``, and ``curve`` bounds how far a distance
    departs from its tangent.
    """
    t, entered = 0.0, 0
    qx, qy, dx, dy = place(ser, px, py)
    for _ in range(64):
        latest, violated, rests, doubtful = t, False, False, 0
        for edge in range(offset.shape[0]):
            nx, ny = normal[edge, 0], normal[edge, 1]
            value, rate = offset[edge] - outside - nx * qx - ny * qy, -nx * dx - ny * dy
            if value + min(0.0, rate * end) - curve * end * end > zero:
                continue
            doubtful += 1
            edge_polynomial(ser, order, nx, ny, offset[edge] - outside, px, py, g)
            if t > 0.0:
                if horner(g, order, t) > zero:
                    continue
                shift(g, order, t, start)
            degree, sign = order, (1 if g[0] > 0.0 else -1)
            if abs(g[0]) <= zero:
                degree, sign = deflate(g, order, zero)
                if sign == 0:
                    rests = True
                    continue
            if sign > 0:
                continue
            violated = True
            negate(g, degree)
            root = first_crossing(g, degree, 1.0, p)
            if root == NONE or t + root > end:
                return NONE, edge
            if t + root >= latest:
                latest, entered = t + root, edge
        if not violated:
            return (NONE if rests and t == 0.0 else t), entered
        t = latest
        if doubtful == 1:
            return t, entered
    return NONE, entered


@kernel
def shift(g, order, t, p):
    """Re-centre ``g`` at ``t`` in place."""
    for k in range(order + 1):
        p[k] = g[k]
    for i in range(order):
        for k in range(order - 1, i - 1, -1):
            p[k] += t * p[k + 1]
    for k in range(order + 1):
        g[k] = p[k]


@kernel
def note(found, count, t, kind, cell, edge):
    """Add an event to the list; returns the new count (events past the list's end fall to the next step)."""
    if count < found.shape[0]:
        found[count, at.EV_TIME], found[count, at.EV_KIND] = t, kind
        found[count, at.EV_CELL], found[count, at.EV_EDGE] = cell, edge
        return count + 1
    return count


@kernel
def reach(ser, order):
    """Bounds on how far the centre of mass moves, and the angle turns, within the unit step."""
    far, turn = 0.0, 0.0
    for k in range(1, order + 1):
        far += (ser[at.S_X, k] * ser[at.S_X, k] + ser[at.S_Y, k] * ser[at.S_Y, k]) ** 0.5
        turn += abs(ser[at.S_TH, k])
    return far, turn


@kernel
def bend(ser, order):
    """Bounds on how far an edge's distance to a cell departs from its tangent within the unit step.

    Returns (for a cell at the centre of mass, more for every metre from it): all terms of ``edge_polynomial`` of
    degree two and up, whatever the edge.
    """
    centre, lever = 0.0, 0.0
    for k in range(2, order + 1):
        centre += (ser[at.S_E1, k] * ser[at.S_E1, k] + ser[at.S_E2, k] * ser[at.S_E2, k]) ** 0.5
        lever += (ser[at.S_C, k] * ser[at.S_C, k] + ser[at.S_S, k] * ser[at.S_S, k]) ** 0.5
    return centre, lever


@kernel
def place(ser, px, py):
    """Compute place and velocity of the cell at (px, py) from ``X0`` in the parcel's axes at the start of the step."""
    c, s, dc, ds = ser[at.S_C, 0], ser[at.S_S, 0], ser[at.S_C, 1], ser[at.S_S, 1]
    qx, qy = c * px + s * py, c * py - s * px
    return qx, qy, dc * px + ds * py - ser[at.S_E1, 1], dc * py - ds * px - ser[at.S_E2, 1]


@kernel
def leaving(surface, parcel, work, order, centre, lever, end, count):
    """Cells that leave the footprint; ``centre`` and ``lever`` are those of ``bend``.

    A captured cell leaves by an edge other than the one it sits on.
    """
    pos, normal, offset, mem, ctl, y = (
        surface.pos,
        parcel.normal,
        parcel.offset,
        parcel.mem,
        parcel.ctl,
        parcel.y,
    )
    ser, found, g, p = work.ser, work.found, work.g, work.p
    zero, outside = parcel.par[at.ON_SURFACE], inset(surface)
    for i in range(ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        px, py = pos[cell, 0] - y[0], pos[cell, 1] - y[1]
        curve = (centre + lever * (px * px + py * py) ** 0.5) * 1.000001
        qx, qy, dx, dy = place(ser, px, py)
        for edge in range(offset.shape[0]):
            nx, ny = normal[edge, 0], normal[edge, 1]
            value, rate = offset[edge] - outside - nx * qx - ny * qy, -nx * dx - ny * dy
            if value + min(0.0, rate * end) - curve * end * end > zero:
                continue
            if mem[i, at.SIDE] != 0 and mem[i, at.EDGE] == edge:
                continue
            edge_polynomial(ser, order, nx, ny, offset[edge] - outside, px, py, g)
            t = crossing(g, order, zero, end, p)
            if t <= end:
                kind = at.CORNER if mem[i, at.SIDE] != 0 else at.LEAVE
                count = note(found, count, t, kind, cell, edge)
                end = min(end, t + SLACK)
    return count, end


@kernel
def entering(surface, parcel, work, order, centre, lever, end, count):
    """Cells that enter the footprint: only those in the box that the footprint can reach are looked at."""
    pos, grid, where = surface.pos, surface.grid, work.where
    vertices, normal, offset, y, par = parcel.vertices, parcel.normal, parcel.offset, parcel.y, parcel.par
    ser, found, g, p, start = work.ser, work.found, work.g, work.p, work.q
    zero, radius, outside = par[at.ON_SURFACE], par[at.RADIUS], inset(surface)
    c, s = ser[at.S_C, 0], ser[at.S_S, 0]
    low_x = high_x = low_y = high_y = 0.0
    for v in range(vertices.shape[0]):
        vx = c * vertices[v, 0] - s * vertices[v, 1]
        vy = s * vertices[v, 0] + c * vertices[v, 1]
        low_x, high_x = min(low_x, vx), max(high_x, vx)
        low_y, high_y = min(low_y, vy), max(high_y, vy)
    far, turn = reach(ser, order)
    swept = (far + turn * radius) * end * 1.000001 + zero + spread(surface, normal)
    pitch = par[at.PITCH]
    left, below = y[0] - par[at.ORIGIN_X], y[1] - par[at.ORIGIN_Y]
    # clamp before the conversion: a swept distance may exceed any integer
    first_column = int(max(0.0, (left + low_x - swept) / pitch))
    last_column = int(min(grid.shape[1] - 1.0, (left + high_x + swept) / pitch))
    first_row = int(max(0.0, (below + low_y - swept) / pitch))
    last_row = int(min(grid.shape[0] - 1.0, (below + high_y + swept) / pitch))
    for row in range(first_row, last_row + 1):
        for column in range(first_column, last_column + 1):
            cell = grid[row, column]
            if cell < 0 or where[cell] != 0:
                continue
            px, py = pos[cell, 0] - y[0], pos[cell, 1] - y[1]
            curve = (centre + lever * (px * px + py * py) ** 0.5) * 1.000001
            near = True
            qx, qy, dx, dy = place(ser, px, py)
            for edge in range(offset.shape[0]):
                nx, ny = normal[edge, 0], normal[edge, 1]
                value, rate = offset[edge] - outside - nx * qx - ny * qy, -nx * dx - ny * dy
                if value + max(0.0, rate * end) + curve * end * end < -zero:
                    near = False
                    break
            if not near:
                continue
            t, edge = entry(ser, order, normal, offset, outside, px, py, curve, zero, end, g, p, start)
            if t <= end:
                count = note(found, count, t, at.ENTER, cell, edge)
                end = min(end, t + SLACK)
    return count, end
