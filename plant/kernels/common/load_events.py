"""The events of one step that loads make: they vanish or return, captured fractions end, a line of supports is left.

All series are in unit time here, as in ``events``.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.events import SLACK, crossing, negate, note
from plant.kernels.common.modes import FRACTION_ZERO
from plant.kernels.common.roots import horner
from plant.kernels.common.springs import gap, negligible


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
def together(found, count, g, order, t, zero):
    """The time of a load's change found before at which ``g`` is zero to rounding too, or else ``t``.

    A difference of rounding between two loads that vanish as one is, in a short step, more of its time than ``apply``
    takes for one instant; the second would then be gone before its event, unreported.
    """
    for i in range(count):
        kind = found[i, at.EV_KIND]
        if (kind == at.UNLOAD or kind == at.TOUCH) and abs(horner(g, order, found[i, at.EV_TIME])) <= zero:
            return found[i, at.EV_TIME]
    return t


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
    zero = negligible(surface, ser[a0, 0])
    swing = 0.0
    for k in range(1, order + 1):
        swing += abs(ser[bx, k]) + abs(ser[by, k])
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell, mark = mem[i, at.CELL], mem[i, at.MARK + m]
        if mark == at.ABSENT or (mark == at.LIFTED and seg[at.RANK] < 2):
            continue
        rx, ry = pos[cell, 0] - y[0] - seg[at.CX], pos[cell, 1] - y[1] - seg[at.CY]
        below = gap(surface, cell)
        now = ser[a0, 0] + ser[bx, 0] * rx + ser[by, 0] * ry - below
        bound = swing * (rx * rx + ry * ry) ** 0.5 * end * 1.000001 + 2.0 * zero
        if abs(now) > bound:
            continue
        for k in range(order + 1):
            g[k] = ser[a0, k] + ser[bx, k] * rx + ser[by, k] * ry
        g[0] -= below
        if mark == at.LIFTED:
            negate(g, order)
        g[0] += 2.0 * zero
        t = crossing(g, order, 0.0, end, work.p)
        if t <= end:
            t = together(work.found, count, g, order, t, zero)
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
