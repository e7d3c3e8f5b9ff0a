"""The events of one step: cells that enter or leave the footprint, loads that vanish or return, fractions that end.

All series are in unit time here (coefficient k times step**k). A candidate whose distance from its surface exceeds
what the motion can cover in the step is passed over by that bound alone; the others are isolated as polynomials.
"""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel
from plant.kernels.loads import LOAD_ZERO
from plant.kernels.modes import FRACTION_ZERO
from plant.kernels.roots import NONE, deflate, first_crossing, horner

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
def entry(ser, order, normal, offset, px, py, zero, end, g, p, start):
    """Earliest time at which a cell outside the footprint is inside every edge. Returns (time, edge).

    Leaps from the last of the violated edges' crossings to the next until none is violated, so that no short stay
    is stepped over. A cell that rests on an edge for the whole step is inside of it, as members on an edge stay
    members; it doesn't enter by that edge, though.
    """
    t, entered = 0.0, 0
    for _ in range(64):
        latest, violated, rests = t, False, False
        for edge in range(offset.shape[0]):
            edge_polynomial(ser, order, normal[edge, 0], normal[edge, 1], offset[edge], px, py, g)
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
def tangent(ser, nx, ny, offset, px, py):
    """Distance inside an edge of the cell at (px, py) from ``X0``, and its rate, at the start of the step."""
    along, across = nx * px + ny * py, nx * py - ny * px
    value = offset - along * ser[at.S_C, 0] - across * ser[at.S_S, 0]
    rate = -along * ser[at.S_C, 1] - across * ser[at.S_S, 1] + nx * ser[at.S_E1, 1] + ny * ser[at.S_E2, 1]
    return value, rate


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
    zero = parcel.par[at.ON_SURFACE]
    for i in range(ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        px, py = pos[cell, 0] - y[0], pos[cell, 1] - y[1]
        curve = (centre + lever * (px * px + py * py) ** 0.5) * 1.000001
        for edge in range(offset.shape[0]):
            if mem[i, at.SIDE] != 0 and mem[i, at.EDGE] == edge:
                continue
            value, rate = tangent(ser, normal[edge, 0], normal[edge, 1], offset[edge], px, py)
            if value + min(0.0, rate * end) - curve * end * end > zero:
                continue
            edge_polynomial(ser, order, normal[edge, 0], normal[edge, 1], offset[edge], px, py, g)
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
    zero, radius = par[at.ON_SURFACE], par[at.RADIUS]
    c, s = ser[at.S_C, 0], ser[at.S_S, 0]
    low_x = high_x = low_y = high_y = 0.0
    for v in range(vertices.shape[0]):
        vx = c * vertices[v, 0] - s * vertices[v, 1]
        vy = s * vertices[v, 0] + c * vertices[v, 1]
        low_x, high_x = min(low_x, vx), max(high_x, vx)
        low_y, high_y = min(low_y, vy), max(high_y, vy)
    far, turn = reach(ser, order)
    swept = (far + turn * radius) * end * 1.000001 + zero
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
            for edge in range(offset.shape[0]):
                value, rate = tangent(ser, normal[edge, 0], normal[edge, 1], offset[edge], px, py)
                if value + max(0.0, rate * end) + curve * end * end < -zero:
                    near = False
                    break
            if not near:
                continue
            t, edge = entry(ser, order, normal, offset, px, py, zero, end, g, p, start)
            if t <= end:
                count = note(found, count, t, at.ENTER, cell, edge)
                end = min(end, t + SLACK)
    return count, end


@kernel
def loading(surface, parcel, work, order, end, count):
    """Loads that vanish, lifted cells that touch again, fractions that reach 0 or 1, a line of supports left."""
    groups = parcel.ctl[at.N_GROUPS]
    for m in range(1 << groups):
        count, end = load_changes(surface, parcel, work, order, end, count, m)
    if groups > 0:
        count, end = fractions(parcel, work, order, end, count)
    if work.segs[0, at.RANK] < 2:
        count, end = off_line(
            work.segs[0], parcel.par, work.ser, order, end, work.found, count, work.g, work.p
        )
    return count, end


@kernel
def load_changes(surface, parcel, work, order, end, count, m):
    """Loads that vanish, and lifted cells that touch again, in mode m.

    A load must pass zero by twice what ``settle`` calls rounding, either way: one that hovers about zero, like that
    of a parcel come to rest, changes nothing.
    """
    pos, mem, y, seg = surface.pos, parcel.mem, parcel.y, work.segs[m]
    ser, g = work.ser, work.g
    o = at.MODES_AT + m * at.MODE_ROWS
    a0, bx, by = o + at.M_A0, o + at.M_BX, o + at.M_BY
    zero = LOAD_ZERO * ser[a0, 0]
    swing = 0.0
    for k in range(1, order + 1):
        swing += abs(ser[bx, k]) + abs(ser[by, k])
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell, mark = mem[i, at.CELL], mem[i, at.MARK + m]
        if mark == at.ABSENT or (mark == at.LIFTED and seg[at.RANK] < 2):
            continue
        rx, ry = pos[cell, 0] - y[0] - seg[at.CX], pos[cell, 1] - y[1] - seg[at.CY]
        now = ser[a0, 0] + ser[bx, 0] * rx + ser[by, 0] * ry
        bound = swing * (rx * rx + ry * ry) ** 0.5 * end * 1.000001 + 2.0 * zero
        if abs(now) > bound:
            continue
        for k in range(order + 1):
            g[k] = ser[a0, k] + ser[bx, k] * rx + ser[by, k] * ry
        if mark == at.LIFTED:
            negate(g, order)
        g[0] += 2.0 * zero
        t = crossing(g, order, 0.0, end, work.p)
        if t <= end:
            count = note(work.found, count, t, at.UNLOAD if mark == at.ACTIVE else at.TOUCH, cell, m)
            end = min(end, t + SLACK)
    return count, end


@kernel
def first_cell(parcel, group):
    """A cell of a captured group."""
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if parcel.mem[i, at.SIDE] != 0 and parcel.mem[i, at.GROUP] == group:
            return parcel.mem[i, at.CELL]
    return at.NO_CELL


@kernel
def fractions(parcel, work, order, end, count):
    """Captured groups one of whose sides takes no more part in the motion: their fraction reaches 0 or 1.

    They must pass it by more than a capture allows, or a fraction at its end would be captured and released in turn.
    """
    g, found = work.g, work.found
    for h in range(parcel.ctl[at.N_GROUPS]):
        for far in range(2):
            for k in range(order + 1):
                g[k] = work.ser[at.S_SHARE + (1 << h), k]
            if far == 1:
                negate(g, order)
                g[0] += 1.0
            g[0] += FRACTION_ZERO
            t = crossing(g, order, 0.0, end, work.p)
            if t <= end:
                kind = at.ONLY_FAR if far == 1 else at.ONLY_NEAR
                count = note(found, count, t, kind, first_cell(parcel, h), h)
                end = min(end, t + SLACK)
    return count, end


@kernel
def off_line(seg, par, ser, order, end, found, count, g, p):
    """A centre of mass that leaves the line (or point) its supports stand on.

    Looked for at twice the distance at which ``settle`` says that it has left: past rounding, the two agree.
    """
    for axis in range(2 if seg[at.RANK] == 0 else 1):
        lx, ly = seg[at.LINE_X], seg[at.LINE_Y]
        if seg[at.RANK] == 0:
            lx, ly = (1.0, 0.0) if axis == 0 else (0.0, 1.0)
        for sign in (1.0, -1.0):
            for k in range(order + 1):
                g[k] = -sign * (lx * ser[at.S_X, k] + ly * ser[at.S_Y, k])
            g[0] += sign * (lx * seg[at.CX] + ly * seg[at.CY]) + 2.0 * par[at.ON_LINE]
            t = crossing(g, order, 0.0, end, p)
            if t <= end:
                count = note(found, count, t, at.LINE, at.NO_CELL, at.ZERO)
                end = min(end, t + SLACK)
    return count, end
