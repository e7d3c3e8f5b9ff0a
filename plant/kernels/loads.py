"""Which cells carry load: the exact unilateral solution, and whether the parcel still stands.

Springs push, never pull: the loads are the least-norm ones that are not negative, which is a strictly convex
problem in the three unknowns of the springs' plane. All supports being in contact is tried first; only when some
load would be negative is the convex problem solved, by Newton's method with a line search.
"""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel
from plant.kernels.moments import segment
from plant.kernels.motion import accelerations, solve, surfaces

FRACTION_ZERO = 1e-9
"""How far a captured cell's load may lie outside [0, full], over the mean load, before its group is released."""
SINGULAR = 1e-9
"""Captured groups whose loads can't be told apart better than this are one too many."""
LOAD_ZERO = 1e-12
"""A share of the mean load that rounding can't tell from none."""


@kernel
def outside_hull(pos, mem, ctl, y, pitch):
    """How far the centre of mass lies outside the convex hull of the cells under the parcel, and by which edge.

    Returns (distance in m, negative inside; cell, cell) with the two supports of the edge it is farthest outside
    of. Gift wrapping: only called when a load would be negative or the supports don't span a plane. Cells lie on a
    lattice, so that any triangle of them has at least half a pitch squared: less is rounding, and a line.
    """
    straight = 0.5 * pitch * pitch
    count = ctl[at.N_MEMBERS]
    first = 0
    for i in range(1, count):
        a, b = mem[i, at.CELL], mem[first, at.CELL]
        if pos[a, 0] < pos[b, 0] or (pos[a, 0] == pos[b, 0] and pos[a, 1] < pos[b, 1]):
            first = i
    worst, edge_a, edge_b = -1e300, mem[first, at.CELL], mem[first, at.CELL]
    corners, here = 0, first
    while corners <= count:
        ax, ay = pos[mem[here, at.CELL], 0] - y[0], pos[mem[here, at.CELL], 1] - y[1]
        following = -1
        fx, fy = 0.0, 0.0
        for i in range(count):
            dx, dy = pos[mem[i, at.CELL], 0] - y[0] - ax, pos[mem[i, at.CELL], 1] - y[1] - ay
            if dx == 0.0 and dy == 0.0:
                continue
            cross = fx * dy - fy * dx
            farther = abs(cross) < straight and dx * dx + dy * dy > fx * fx + fy * fy
            if following < 0 or cross <= -straight or farther:
                following, fx, fy = i, dx, dy
        if following < 0:
            return (ax * ax + ay * ay) ** 0.5, edge_a, edge_b
        size = (fx * fx + fy * fy) ** 0.5
        distance = (ay * fx - ax * fy) / size  # outward is to the right of a counter-clockwise edge
        along = -(ax * fx + ay * fy) / size
        if corners == 1 and following == first:
            # all on one line: the hull is a segment, left over its side or past one of its ends
            past = max(-along, along - size)
            off = abs(distance)
            if past > off:
                end = mem[following if along > 0.0 else here, at.CELL]
                return (off * off + past * past) ** 0.5, end, end
            return (
                (off if past <= 0.0 else (off * off + past * past) ** 0.5),
                mem[here, at.CELL],
                mem[following, at.CELL],
            )
        if distance > worst:
            worst, edge_a, edge_b = distance, mem[here, at.CELL], mem[following, at.CELL]
        corners += 1
        here = following
        if here == first:
            break
    return worst, edge_a, edge_b


@kernel
def potential(pos, mem, ctl, y, length, ox, oy, z, w):
    """Half the squared loads minus the work of the weight: convex, least at the springs' plane ``z``."""
    total = -(z[0] * w[0] + z[1] * w[1] + z[2] * w[2])
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.MARK] != at.CAPTURED:
            cell = mem[i, at.CELL]
            rx, ry = (pos[cell, 0] - y[0] - ox) / length, (pos[cell, 1] - y[1] - oy) / length
            n = z[0] + z[1] * rx + z[2] * ry
            if n > 0.0:
                total += 0.5 * n * n
    return total


@kernel
def gradient(pos, mem, ctl, y, length, ox, oy, z, w, hessian, slope):
    """Gradient and Hessian of ``potential``. Returns how many cells carry load on the plane ``z``."""
    for i in range(3):
        slope[i] = -w[i]
        for j in range(3):
            hessian[i, j] = 0.0
    count = 0
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.MARK] != at.CAPTURED:
            cell = mem[i, at.CELL]
            rx, ry = (pos[cell, 0] - y[0] - ox) / length, (pos[cell, 1] - y[1] - oy) / length
            n = z[0] + z[1] * rx + z[2] * ry
            if n > 0.0:
                count += 1
                slope[0] += n
                slope[1] += n * rx
                slope[2] += n * ry
                hessian[0, 0] += 1.0
                hessian[0, 1] += rx
                hessian[0, 2] += ry
                hessian[1, 1] += rx * rx
                hessian[1, 2] += rx * ry
                hessian[2, 2] += ry * ry
    hessian[1, 0], hessian[2, 0], hessian[2, 1] = hessian[0, 1], hessian[0, 2], hessian[1, 2]
    return count


@kernel
def remaining(seg, grp, f, groups):
    """Share of the weight, and its moment about the centroid, that captured cells leave to the active supports."""
    total, mx, my = 1.0, -seg[at.CX], -seg[at.CY]
    if groups > 0:
        total -= grp[at.FIXED, at.S_SUM]
        mx -= grp[at.FIXED, at.S_RX]
        my -= grp[at.FIXED, at.S_RY]
    for h in range(groups):
        total -= f[h] * grp[h, at.S_SUM]
        mx -= f[h] * grp[h, at.S_RX]
        my -= f[h] * grp[h, at.S_RY]
    return total, mx, my


@kernel
def contact(pos, mem, ctl, y, par, seg, grp, f, scratch, newton):
    """Mark every cell under the parcel as carrying load or lifted, at the minimum of ``potential``."""
    z, w, slope, step, trial = newton[0], newton[1], newton[2], newton[3], newton[4]
    hessian = newton[5:8]
    length, ox, oy = par[at.PITCH], seg[at.CX], seg[at.CY]
    total, mx, my = remaining(seg, grp, f, ctl[at.N_GROUPS])
    w[0], w[1], w[2] = total, mx / length, my / length
    z[0], z[1], z[2] = 1.0 / ctl[at.N_MEMBERS], 0.0, 0.0
    value = potential(pos, mem, ctl, y, length, ox, oy, z, w)
    for _ in range(200):
        count = gradient(pos, mem, ctl, y, length, ox, oy, z, w, hessian, slope)
        size = abs(slope[0]) + abs(slope[1]) + abs(slope[2])
        if size <= 1e-14:
            break
        # a set of supports that spans no plane leaves the Hessian singular: a trace of ridge keeps the step finite
        ridge = 1e-13 * (1.0 + count)
        for i in range(3):
            hessian[i, i] += ridge
            trial[i] = -slope[i]
        solve(hessian, hessian.shape[0], trial, step, scratch)
        descent = slope[0] * step[0] + slope[1] * step[1] + slope[2] * step[2]
        t = 1.0
        improved = False
        for _ in range(60):
            for i in range(3):
                trial[i] = z[i] + t * step[i]
            following = potential(pos, mem, ctl, y, length, ox, oy, trial, w)
            if following <= value + 1e-4 * t * descent:
                improved = following < value
                break
            t *= 0.5
        if not improved:
            break
        for i in range(3):
            z[i] = trial[i]
        value = following
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.MARK] != at.CAPTURED:
            cell = mem[i, at.CELL]
            rx, ry = (pos[cell, 0] - y[0] - ox) / length, (pos[cell, 1] - y[1] - oy) / length
            mem[i, at.MARK] = at.ACTIVE if z[0] + z[1] * rx + z[2] * ry > 0.0 else at.LIFTED


@kernel
def plane(seg, grp, f, groups):
    """The springs' plane now: load share ``a0 + b . r`` of a cell at r from the centroid."""
    total, mx, my = remaining(seg, grp, f, groups)
    return total / seg[at.N_ACTIVE], seg[at.PXX] * mx + seg[at.PXY] * my, seg[at.PXY] * mx + seg[at.PYY] * my


@kernel
def violated(pos, mem, ctl, y, par, seg, a0, bx, by):
    """True where a cell marked as loaded would pull, or one marked as lifted would be pressed."""
    zero = LOAD_ZERO * a0
    for i in range(ctl[at.N_MEMBERS]):
        mark = mem[i, at.MARK]
        if mark == at.CAPTURED:
            continue
        rx = pos[mem[i, at.CELL], 0] - y[0] - seg[at.CX]
        ry = pos[mem[i, at.CELL], 1] - y[1] - seg[at.CY]
        n = a0 + bx * rx + by * ry
        if mark == at.ACTIVE and n < -zero:
            return True
        if mark == at.LIFTED and n > zero:
            # on a line of supports the plane may tilt about the line: cells beside it stay clear
            if seg[at.RANK] == 2:
                return True
            if seg[at.RANK] == 1 and abs(seg[at.LINE_X] * rx + seg[at.LINE_Y] * ry) <= par[at.ON_LINE]:
                return True
    return False


@kernel
def exchange(pos, mem, ctl, y, seg, a0, bx, by):
    """Turn round the mark that is farthest from what its load says.

    ``contact`` finds the supports to the rounding of its potential, half the digits of a load; loads nearer to zero
    than that are sorted out here, one by one.
    """
    worst, which = 0.0, -1
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.MARK] != at.CAPTURED:
            rx = pos[mem[i, at.CELL], 0] - y[0] - seg[at.CX]
            ry = pos[mem[i, at.CELL], 1] - y[1] - seg[at.CY]
            n = a0 + bx * rx + by * ry
            wrong = -n if mem[i, at.MARK] == at.ACTIVE else n
            if wrong > worst:
                worst, which = wrong, i
    if which >= 0:
        mem[which, at.MARK] = at.LIFTED if mem[which, at.MARK] == at.ACTIVE else at.ACTIVE


@kernel
def drop(mem, share, ctl, i):
    """Take member ``i`` off the list (the last takes its place)."""
    last = ctl[at.N_MEMBERS] - 1
    for k in range(mem.shape[1]):
        mem[i, k] = mem[last, k]
    share[i, at.SHARE], share[i, at.BASE] = share[last, at.SHARE], share[last, at.BASE]
    ctl[at.N_MEMBERS] = last


@kernel
def release(mem, share, ctl, group, complete):
    """End a captured group: ``complete`` where its fraction reached one, else its cells go back to where they were.

    Cells that load as the fraction grows are then inside the footprint, those that unload are outside; or the other
    way round.
    """
    i = at.ZERO
    while i < ctl[at.N_MEMBERS]:
        if mem[i, at.MARK] == at.CAPTURED:
            if mem[i, at.GROUP] == group:
                mem[i, at.MARK] = at.ACTIVE
                if (share[i, at.SHARE] > 0.0) != complete:
                    drop(mem, share, ctl, i)
                    continue
            elif mem[i, at.GROUP] > group:
                mem[i, at.GROUP] -= 1
        i += 1
    ctl[at.N_GROUPS] -= 1


@kernel
def excess(pos, mem, share, y, seg, f, a0, bx, by, i):
    """How far a captured cell's load lies outside [0, full], over the mean load, and which end of the fraction that is.

    Returns (excess below nothing or above full, whichever is larger; True where the group's fraction exceeds one).
    """
    rx = pos[mem[i, at.CELL], 0] - y[0] - seg[at.CX]
    ry = pos[mem[i, at.CELL], 1] - y[1] - seg[at.CY]
    load = share[i, at.BASE] + share[i, at.SHARE] * f[mem[i, at.GROUP]]
    below, above = -load / a0, (load - (a0 + bx * rx + by * ry)) / a0
    loads_up = share[i, at.SHARE] > 0.0
    if below > above:
        return below, not loads_up
    return above, loads_up


@kernel
def release_one_outside(pos, mem, share, ctl, y, seg, f, a0, bx, by):
    """Release the captured group whose fraction is farthest outside [0, 1]. Returns True where there was one."""
    worst, which, complete = FRACTION_ZERO, at.NO_CELL, at.UNDONE
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, at.MARK] == at.CAPTURED:
            amount, end = excess(pos, mem, share, y, seg, f, a0, bx, by, i)
            if amount > worst:
                worst, which, complete = amount, mem[i, at.GROUP], end
    if which >= 0:
        release(mem, share, ctl, which, complete)
        return True
    return False


@kernel
def release_all(mem, share, ctl):
    """End all captured groups: their cells carry load like any other."""
    while ctl[at.N_GROUPS] > 0:
        release(mem, share, ctl, ctl[at.N_GROUPS] - 1, at.COMPLETE)


@kernel
def stands(surface, parcel, work):
    """Whether supports that span no plane carry the parcel. Returns (tipped, off their line)."""
    seg, ctl, y = work.seg, parcel.ctl, parcel.y
    distance, a, b = outside_hull(surface.pos, parcel.mem, ctl, y, parcel.par[at.PITCH])
    ctl[at.TIP_A], ctl[at.TIP_B] = a, b
    if distance > parcel.par[at.ON_LINE]:
        return True, False
    off = abs(seg[at.LINE_X] * seg[at.CX] + seg[at.LINE_Y] * seg[at.CY])
    if seg[at.RANK] == 0:
        off = (seg[at.CX] * seg[at.CX] + seg[at.CY] * seg[at.CY]) ** 0.5
    return False, off > parcel.par[at.ON_LINE]


@kernel
def settled(surface, parcel, work, e, c, s):
    """Find the loads at this instant: constants, marks, captured fractions, accelerations.

    Tries what stands first; where a load would pull, solves the contact problem; where a captured fraction leaves
    [0, 1], releases that group; until nothing changes. Returns the status; with TIPPED the edge is in ``ctl``.
    """
    pos, mem, share, ctl, y, par = surface.pos, parcel.mem, parcel.share, parcel.ctl, parcel.y, parcel.par
    seg, grp, f = work.seg, work.grp, work.f
    near = False
    for attempt in range(40):
        if ctl[at.N_MEMBERS] == 0:
            ctl[at.TIP_A] = ctl[at.TIP_B] = -1
            return at.TIPPED
        segment(pos, surface.steady, surface.decay, surface.grip, mem, share, ctl, y, par, seg, grp)
        if seg[at.N_ACTIVE] == 0 or (seg[at.RANK] < 2 and ctl[at.N_GROUPS] > 0):
            release_all(mem, share, ctl)
            for i in range(ctl[at.N_MEMBERS]):
                mem[i, at.MARK] = at.ACTIVE
            segment(pos, surface.steady, surface.decay, surface.grip, mem, share, ctl, y, par, seg, grp)
        if seg[at.RANK] < 2:
            tipped, off_line = stands(surface, parcel, work)
            if tipped:
                return at.TIPPED
            if off_line and near:
                # past a corner of the hull by more than past either edge: no set of loads is better than this one
                return at.TIPPED
            if off_line:
                near = True
                contact(pos, mem, ctl, y, par, seg, grp, f, work.scratch, work.newton)
                continue
        if ctl[at.N_GROUPS] > 0:
            surfaces(pos, parcel.normal, parcel.offset, mem, share, ctl, y, grp)
        _, _, _, conditioning = accelerations(
            seg, grp, ctl, y, par, e, c, s, work.matrix, work.reply, f, work.scratch
        )
        if ctl[at.N_GROUPS] > 0 and conditioning < SINGULAR:
            release(mem, share, ctl, ctl[at.N_GROUPS] - 1, at.COMPLETE)
            continue
        a0, bx, by = plane(seg, grp, f, ctl[at.N_GROUPS])
        if violated(pos, mem, ctl, y, par, seg, a0, bx, by):
            if seg[at.RANK] == 2:
                tipped, _ = stands(surface, parcel, work)
                if tipped:
                    return at.TIPPED
            if attempt >= 20:
                release_all(mem, share, ctl)
            if near and attempt % 10 != 9:
                exchange(pos, mem, ctl, y, seg, a0, bx, by)
            else:
                contact(pos, mem, ctl, y, par, seg, grp, f, work.scratch, work.newton)
                near = True
            continue
        if ctl[at.N_GROUPS] > 0 and release_one_outside(pos, mem, share, ctl, y, seg, f, a0, bx, by):
            ctl[at.N_CAPTURES] += 1
            near = False
            continue
        return at.MOVING
    return at.NO_LOADS
