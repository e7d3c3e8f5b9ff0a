"""Chatter at a surface that attracts from both sides, replaced by motion along it (Filippov).

A parcel that settles at an orientation where the support set changes crosses the same surface ever faster. Once the
amplitude of that motion falls below ``capture_m``, the cells on the surface are captured: the motions on its two sides
mix so that the surface's second rate is zero, and the parcel moves along it (``modes``). Cells that reach their edges
at one instant form one group with one fraction; so does a cell whose surface has merged with a group's.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.modes import (
    FRACTION_ZERO,
    least_share,
    mix,
    put_in,
    release_inside,
    settle_modes,
)
from plant.kernels.common.motion import surfaces
from plant.kernels.common.springs import shift_alike

INDEPENDENT = 1e-6
"""Groups whose effects on their surfaces are closer to singular than this count as one."""


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
def depth(surface, parcel, cell, edge, c, s):
    """Distance of a cell inside one edge."""
    px, py = surface.pos[cell, 0] - parcel.y[0], surface.pos[cell, 1] - parcel.y[1]
    qx, qy = c * px + s * py, -s * px + c * py
    return parcel.offset[edge] - parcel.normal[edge, 0] * qx - parcel.normal[edge, 1] * qy


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
    """Accelerations into ``work.after`` with the cells as they stand, whatever the fractions; their conditioning.

    0 where some mode's supports don't carry the parcel, or span no plane.
    """
    if settle_modes(surface, parcel, work, e) != at.MOVING or work.segs[0, at.RANK] < 2:
        return 0.0
    surfaces(surface, parcel, work.grp)
    ax, ay, al, conditioning = mix(work, surface, parcel, e, c, s)
    work.after[0], work.after[1], work.after[2] = ax, ay, al
    return conditioning


@kernel
def slot_of(mem, ctl, cell):
    """Return the slot of a cell among the members, or -1."""
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.CELL] == cell:
            return i
    return -1


@kernel
def side_in(surface, parcel, work, group, i, c, s):
    """On which side of a captured group's surface the i-th cell that crossed is under the parcel: 1 far, -1 near."""
    cell, edge, reply = work.cells[i], work.edges[i], work.reply
    nx = c * parcel.normal[edge, 0] - s * parcel.normal[edge, 1]
    ny = s * parcel.normal[edge, 0] + c * parcel.normal[edge, 1]
    rx, ry = parcel.y[0] - surface.pos[cell, 0], parcel.y[1] - surface.pos[cell, 1]
    pull = nx * reply[0, group] + ny * reply[1, group] + (-ny * rx + nx * ry) * reply[2, group]
    # the far side's own pull is back towards the surface, and so is that on the cell's distance if they run alike
    return 1 if pull * work.matrix[group, group] > 0.0 else -1


@kernel
def capture(surface, parcel, work, group, c, s):
    """Add the cells that crossed to ``group``. The far side of a new group is the side to which its cells crossed."""
    mem, ctl = parcel.mem, parcel.ctl
    fresh = group == ctl[at.N_GROUPS]
    if fresh:
        for i in range(ctl[at.N_MEMBERS]):
            for m in range(1 << group):
                mem[i, at.MARK + (m | 1 << group)] = mem[i, at.MARK + m]
        for m in range(1 << group):
            shift_alike(surface, m | 1 << group, m)
    for i in range(ctl[at.N_CROSSED]):
        side = work.signs[i] if fresh else side_in(surface, parcel, work, group, i, c, s)
        slot = slot_of(mem, ctl, work.cells[i])
        if slot < 0:
            slot = ctl[at.N_MEMBERS]
            ctl[at.N_MEMBERS] += 1
            mem[slot, at.CELL] = work.cells[i]
            for m in range(at.MODES):
                mem[slot, at.MARK + m] = at.ACTIVE
        mem[slot, at.EDGE] = work.edges[i]
        put_in(mem, slot, group, side)
    if fresh:
        ctl[at.N_GROUPS] += 1


@kernel
def keep(parcel, work):
    """Remember the members, to be able to go back."""
    for i in range(parcel.ctl[at.N_MEMBERS]):
        for k in range(at.MEM_COLUMNS):
            work.saved[i, k] = parcel.mem[i, k]
    return parcel.ctl[at.N_MEMBERS], parcel.ctl[at.N_GROUPS]


@kernel
def restore(parcel, work, members, groups):
    """Go back to the members remembered."""
    for i in range(members):
        for k in range(at.MEM_COLUMNS):
            parcel.mem[i, k] = work.saved[i, k]
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
    if evaluate(surface, parcel, work, e, c, s) == 0.0 or not attracts(surface, parcel, work, c, s):
        return False
    members, groups = keep(parcel, work)
    for group in range(groups, -1, -1):
        if group == at.MAX_GROUPS:
            continue
        capture(surface, parcel, work, group, c, s)
        if evaluate(surface, parcel, work, e, c, s) > INDEPENDENT:
            share, _, _ = least_share(parcel, work)
            # closer than where it would be released
            if share >= -0.25 * FRACTION_ZERO:
                ctl[at.N_CAPTURES] += 1
                ctl[at.N_LAST] = 0
                return True
        restore(parcel, work, members, groups)
        evaluate(surface, parcel, work, e, c, s)
    return False


@kernel
def join_last(surface, parcel, work, c, s):
    """Join cells of the previous crossing to this crossing if they are within ``capture_m`` of their edges.

    The cells of a pair that merges reach their edges shortly after one another. With only one of the two across,
    neither side of the chatter is visible. ``work.before`` becomes the accelerations before the first crossing. This
    crossing is stored for the next call. Returns whether any cell joined.
    """
    mem, ctl, last = parcel.mem, parcel.ctl, work.last
    own = ctl[at.N_CROSSED]
    joined = own
    for i in range(ctl[at.N_LAST]):
        cell, edge, sign = last[i, 0], last[i, 1], last[i, 2]
        slot = slot_of(mem, ctl, cell)
        free = slot < 0 or mem[slot, at.SIDE] == 0
        for k in range(own):
            free = free and work.cells[k] != cell
        rate, _ = edge_motion(surface.pos, parcel.normal, cell, edge, parcel.y, c, s, work.before)
        merged = sign * rate > 0.0 and abs(depth(surface, parcel, cell, edge, c, s)) <= parcel.par[at.CAPTURE]
        if free and merged and joined < work.cells.shape[0]:
            work.cells[joined], work.edges[joined], work.signs[joined] = cell, edge, sign
            joined += 1
    for i in range(own):
        last[i, 0], last[i, 1], last[i, 2] = work.cells[i], work.edges[i], work.signs[i]
    for k in range(3):
        work.before[k], work.earlier[k] = work.earlier[k], work.before[k]
    ctl[at.N_LAST], ctl[at.N_CROSSED] = own, joined
    return joined > own


@kernel
def groups_hold(surface, parcel, c, s):
    """Release groups whose cells no longer lie on their common surface (a pair that drifts apart)."""
    mem, ctl = parcel.mem, parcel.ctl
    h = at.ZERO
    while h < ctl[at.N_GROUPS]:
        low, high = 1e300, -1e300
        for i in range(ctl[at.N_MEMBERS]):
            if mem[i, at.SIDE] != 0 and mem[i, at.GROUP] == h:
                distance = depth(surface, parcel, mem[i, at.CELL], mem[i, at.EDGE], c, s)
                low, high = min(low, mem[i, at.SIDE] * distance), max(high, mem[i, at.SIDE] * distance)
        if high - low > 2.0 * parcel.par[at.CAPTURE]:
            release_inside(surface, mem, ctl, h)
            ctl[at.N_CAPTURES] += 1
        else:
            h += 1
