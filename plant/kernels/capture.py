"""Chatter at a surface that attracts from both sides, replaced by motion along it (Filippov).

A parcel that settles at an orientation where the support set changes crosses the same surface ever faster. Once the
amplitude of that motion falls below ``capture_m``, the cells on the surface are captured: they carry the fraction of
their load that keeps the surface's second rate at zero, and the parcel moves along the surface. Cells that reach their
edges at one instant form one group with one fraction; so does a cell whose surface has merged with a group's.
"""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel
from plant.kernels.loads import FRACTION_ZERO, excess, plane, release
from plant.kernels.moments import segment
from plant.kernels.motion import accelerations, surfaces

INDEPENDENT = 1e-6
"""Surfaces whose response to captured loads is closer to singular than this count as one."""


@kernel
def edge_of(pos, normal, offset, cell, y, c, s):
    """The edge on whose line a cell lies nearest, and its distance from that line."""
    px, py = pos[cell, 0] - y[0], pos[cell, 1] - y[1]
    qx, qy = c * px + s * py, -s * px + c * py
    nearest, least = 0, 1e300
    for edge in range(offset.shape[0]):
        distance = abs(offset[edge] - normal[edge, 0] * qx - normal[edge, 1] * qy)
        if distance < least:
            nearest, least = edge, distance
    return nearest, least


@kernel
def edge_motion(pos, normal, cell, edge, y, c, s, a):
    """Rate and second rate of a cell's distance inside an edge, for the accelerations ``a`` (3,)."""
    nx = c * normal[edge, 0] - s * normal[edge, 1]
    ny = s * normal[edge, 0] + c * normal[edge, 1]
    rx, ry = y[0] - pos[cell, 0], y[1] - pos[cell, 1]
    om = y[at.OMEGA]
    along, across = nx * rx + ny * ry, -ny * rx + nx * ry
    rate = nx * y[at.UX] + ny * y[at.UY] + om * across
    second = nx * a[0] + ny * a[1] + a[2] * across - om * om * along
    second += 2.0 * om * (-ny * y[at.UX] + nx * y[at.UY])
    return rate, second


@kernel
def small(surface, parcel, work, c, s):
    """Whether every cell that crossed moves about its surface by less than ``capture_m``, as far as one side tells."""
    bound = 2.0 * parcel.par[at.CAPTURE]
    for i in range(parcel.ctl[at.N_CROSSED]):
        rate, second = edge_motion(
            surface.pos, parcel.normal, work.cells[i], work.edges[i], parcel.y, c, s, work.before
        )
        if rate * rate >= bound * abs(second):
            return False
    return True


@kernel
def attracts(surface, parcel, work, c, s):
    """Whether every surface crossed draws the parcel in from both sides, its motion smaller than ``capture_m``."""
    bound = 2.0 * parcel.par[at.CAPTURE]
    for i in range(parcel.ctl[at.N_CROSSED]):
        cell, edge, sign = work.cells[i], work.edges[i], work.signs[i]
        rate, before = edge_motion(surface.pos, parcel.normal, cell, edge, parcel.y, c, s, work.before)
        rate, after = edge_motion(surface.pos, parcel.normal, cell, edge, parcel.y, c, s, work.after)
        if not (sign * before > 0.0 > sign * after) or rate * rate >= bound * min(abs(before), abs(after)):
            return False
    return True


@kernel
def evaluate(surface, parcel, work, e, c, s):
    """Accelerations into ``work.after`` with the marks as they stand, whatever the fractions; their conditioning."""
    ctl, y, par = parcel.ctl, parcel.y, parcel.par
    segment(
        surface.pos,
        surface.steady,
        surface.decay,
        surface.grip,
        parcel.mem,
        parcel.share,
        ctl,
        y,
        par,
        work.seg,
        work.grp,
    )
    if work.seg[at.N_ACTIVE] == 0 or work.seg[at.RANK] < 2:
        return 0.0
    if ctl[at.N_GROUPS] > 0:
        surfaces(surface.pos, parcel.normal, parcel.offset, parcel.mem, parcel.share, ctl, y, work.grp)
    ax, ay, al, conditioning = accelerations(
        work.seg, work.grp, ctl, y, par, e, c, s, work.matrix, work.reply, work.f, work.scratch
    )
    work.after[0], work.after[1], work.after[2] = ax, ay, al
    return conditioning


@kernel
def fractions_fit(surface, parcel, work):
    """Whether every captured cell carries between nothing and its full load, closer than where it would be released."""
    mem, ctl, seg = parcel.mem, parcel.ctl, work.seg
    a0, bx, by = plane(seg, work.grp, work.f, ctl[at.N_GROUPS])
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.MARK] == at.CAPTURED:
            amount, _ = excess(surface.pos, mem, parcel.share, parcel.y, seg, work.f, a0, bx, by, i)
            if amount > 0.25 * FRACTION_ZERO:
                return False
    return True


@kernel
def mark_captured(surface, parcel, work, group):
    """Captures the cells that crossed into ``group``, with shares in proportion to their full loads.

    Where some entered and others left at once, those that left start from the load they had and give it up as the
    fraction grows. Where all left, the fraction is that of being inside, as if they had entered.
    """
    pos, y, mem, share, ctl, seg, before = (
        surface.pos,
        parcel.y,
        parcel.mem,
        parcel.share,
        parcel.ctl,
        work.seg,
        work.before,
    )
    a0, bx, by = plane(seg, work.grp, work.f, ctl[at.N_GROUPS])
    mixed = False
    for i in range(1, parcel.ctl[at.N_CROSSED]):
        mixed = mixed or work.signs[i] != work.signs[0]
    for i in range(parcel.ctl[at.N_CROSSED]):
        cell = work.cells[i]
        slot = -1
        for j in range(ctl[at.N_MEMBERS]):
            if mem[j, at.CELL] == cell:
                slot = j
        if slot < 0:
            slot = ctl[at.N_MEMBERS]
            ctl[at.N_MEMBERS] += 1
            mem[slot, at.CELL] = cell
        mem[slot, at.MARK], mem[slot, at.EDGE], mem[slot, at.GROUP] = at.CAPTURED, work.edges[i], group
        if mixed and work.signs[i] < 0:
            rx, ry = pos[cell, 0] - before[6], pos[cell, 1] - before[7]
            load = max(before[3] + before[4] * rx + before[5] * ry, 1e-6 * a0)
            share[slot, at.SHARE], share[slot, at.BASE] = -load, load
        else:
            rx, ry = pos[cell, 0] - y[0] - seg[at.CX], pos[cell, 1] - y[1] - seg[at.CY]
            share[slot, at.SHARE], share[slot, at.BASE] = max(a0 + bx * rx + by * ry, 1e-6 * a0), 0.0
    ctl[at.N_GROUPS] = max(ctl[at.N_GROUPS], group + 1)
    total = 0.0
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.MARK] == at.CAPTURED and mem[i, at.GROUP] == group:
            if not mixed:
                # full loads anew for all: the group may have had members before
                rx, ry = (
                    pos[mem[i, at.CELL], 0] - y[0] - seg[at.CX],
                    pos[mem[i, at.CELL], 1] - y[1] - seg[at.CY],
                )
                share[i, at.SHARE] = max(a0 + bx * rx + by * ry, 1e-6 * a0)
            total += abs(share[i, at.SHARE])
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.MARK] == at.CAPTURED and mem[i, at.GROUP] == group:
            share[i, at.SHARE] /= total


@kernel
def may_join(parcel, work, group):
    """Whether the cells that crossed may join a group: both all load as their fraction grows."""
    mem, share, ctl = parcel.mem, parcel.share, parcel.ctl
    for i in range(1, parcel.ctl[at.N_CROSSED]):
        if work.signs[i] != work.signs[0]:
            return False
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.MARK] == at.CAPTURED and mem[i, at.GROUP] == group and share[i, at.SHARE] < 0.0:
            return False
    return True


@kernel
def keep(parcel, work):
    """Remember the members, to be able to go back."""
    for i in range(parcel.ctl[at.N_MEMBERS]):
        for k in range(4):
            work.kept[i, k] = parcel.mem[i, k]
        work.kept_share[i, 0], work.kept_share[i, 1] = parcel.share[i, 0], parcel.share[i, 1]
    return parcel.ctl[at.N_MEMBERS], parcel.ctl[at.N_GROUPS]


@kernel
def restore(parcel, work, members, groups):
    """Go back to the members remembered."""
    for i in range(members):
        for k in range(4):
            parcel.mem[i, k] = work.kept[i, k]
        parcel.share[i, 0], parcel.share[i, 1] = work.kept_share[i, 0], work.kept_share[i, 1]
    parcel.ctl[at.N_MEMBERS], parcel.ctl[at.N_GROUPS] = members, groups


@kernel
def try_capture(surface, parcel, work, e, c, s):
    """Capture the cells that just crossed, where their surface attracts from both sides. Returns whether it does.

    As a group of their own where their surface is independent of those captured already, else with the group
    whose surface theirs has merged with; only where all fractions then lie in [0, 1].
    """
    ctl = parcel.ctl
    if not small(surface, parcel, work, c, s):
        return False
    members, groups = keep(parcel, work)
    if evaluate(surface, parcel, work, e, c, s) == 0.0:
        return False
    if not attracts(surface, parcel, work, c, s):
        return False
    for group in range(groups, -1, -1):
        if group == at.MAX_GROUPS:
            continue
        if group < groups and not may_join(parcel, work, group):
            continue
        mark_captured(surface, parcel, work, group)
        if evaluate(surface, parcel, work, e, c, s) > INDEPENDENT and fractions_fit(surface, parcel, work):
            ctl[at.N_CAPTURES] += 1
            return True
        restore(parcel, work, members, groups)
        evaluate(surface, parcel, work, e, c, s)
    return False


@kernel
def groups_hold(surface, parcel, c, s):
    """Release groups whose cells no longer lie on their common surface (a pair that drifts apart)."""
    mem, ctl, y = parcel.mem, parcel.ctl, parcel.y
    h = at.ZERO
    while h < ctl[at.N_GROUPS]:
        low, high = 1e300, -1e300
        for i in range(ctl[at.N_MEMBERS]):
            if mem[i, at.MARK] == at.CAPTURED and mem[i, at.GROUP] == h:
                px, py = surface.pos[mem[i, at.CELL], 0] - y[0], surface.pos[mem[i, at.CELL], 1] - y[1]
                qx, qy = c * px + s * py, -s * px + c * py
                edge = mem[i, at.EDGE]
                distance = parcel.offset[edge] - parcel.normal[edge, 0] * qx - parcel.normal[edge, 1] * qy
                low, high = min(low, distance), max(high, distance)
        if high - low > 2.0 * parcel.par[at.CAPTURE]:
            release(mem, parcel.share, ctl, h, at.COMPLETE)
            ctl[at.N_CAPTURES] += 1
        else:
            h += 1
