"""Load-carrying cells of a parcel: the exact unilateral solution, and whether the parcel still stands.

Springs push, never pull: the loads are the least-norm ones that are not negative, which is a strictly convex
problem in the three unknowns of the springs' plane. All supports being in contact is tried first; only when some
load would be negative is the convex problem solved, by Newton's method with a line search.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.moments import segment
from plant.kernels.common.motion import solve
from plant.kernels.common.springs import gap, negligible, plane_at, shift, stiffness, unshift


@kernel
def outside_hull(pos, mem, ctl, y, pitch, mark):
    """How far the load's centre ``y`` lies outside the convex hull of one mode's cells, and by which edge.

    Returns (distance in m, negative inside; cell, cell) with the two supports of the edge it is farthest outside
    of. Gift wrapping: only called when a load would be negative or the supports don't span a plane. Cells lie on a
    lattice, so that any triangle of them has at least half a pitch squared: less is rounding, and a line.
    """
    straight = 0.5 * pitch * pitch
    count = ctl[at.N_MEMBERS]
    first = -1
    for i in range(count):
        if mem[i, mark] == at.ABSENT:
            continue
        if first < 0:
            first = i
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
            if (dx == 0.0 and dy == 0.0) or mem[i, mark] == at.ABSENT:
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
def pressed(surface, parcel, z, origin, cell):
    """Place of a cell in pitches from ``origin`` (x, y from the parcel, pitch), and how far the plane z presses it."""
    rx = (surface.pos[cell, 0] - parcel.y[0] - origin[0]) / origin[2]
    ry = (surface.pos[cell, 1] - parcel.y[1] - origin[1]) / origin[2]
    return rx, ry, z[0] + z[1] * rx + z[2] * ry - gap(surface, cell)


@kernel
def potential(surface, parcel, mark, origin, z, w):
    """The springs' energy minus the work of the weight: convex, least at the springs' plane ``z``."""
    mem = parcel.mem
    total = -(z[0] * w[0] + z[1] * w[1] + z[2] * w[2])
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if mem[i, mark] != at.ABSENT:
            cell = mem[i, at.CELL]
            _, _, n = pressed(surface, parcel, z, origin, cell)
            if n > 0.0:
                total += 0.5 * stiffness(surface, cell, i) * n * n
    return total


@kernel
def gradient(surface, parcel, mark, origin, z, w, hessian, slope):
    """Gradient and Hessian of ``potential``. Returns how many cells carry load on the plane ``z``."""
    mem = parcel.mem
    for i in range(3):
        slope[i] = -w[i]
        for j in range(3):
            hessian[i, j] = 0.0
    count = 0
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if mem[i, mark] != at.ABSENT:
            cell = mem[i, at.CELL]
            rx, ry, n = pressed(surface, parcel, z, origin, cell)
            if n > 0.0:
                k = stiffness(surface, cell, i)
                count += 1
                slope[0] += k * n
                slope[1] += k * n * rx
                slope[2] += k * n * ry
                hessian[0, 0] += k
                hessian[0, 1] += k * rx
                hessian[0, 2] += k * ry
                hessian[1, 1] += k * rx * rx
                hessian[1, 2] += k * rx * ry
                hessian[2, 2] += k * ry * ry
    hessian[1, 0], hessian[2, 0], hessian[2, 1] = hessian[0, 1], hessian[0, 2], hessian[1, 2]
    return count


@kernel
def widest_gap(surface, parcel, mark):
    """The widest gap of a mode's cells: a level plane beyond it presses them all."""
    widest = -1e300
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if parcel.mem[i, mark] != at.ABSENT:
            widest = max(widest, gap(surface, parcel.mem[i, at.CELL]))
    return widest


@kernel
def contact(surface, parcel, seg, mark, scratch, newton):
    """Mark every cell under the parcel as carrying load or lifted, at the minimum of ``potential``."""
    mem, ctl = parcel.mem, parcel.ctl
    z, w, slope, step, trial = newton[0], newton[1], newton[2], newton[3], newton[4]
    hessian = newton[5:8]
    origin = (seg[at.CX], seg[at.CY], parcel.par[at.PITCH])
    sx, sy = shift(surface, mark - at.MARK)
    w[0], w[1], w[2] = 1.0, (sx - origin[0]) / origin[2], (sy - origin[1]) / origin[2]
    z[0], z[1], z[2] = 1.0 / ctl[at.N_MEMBERS] + widest_gap(surface, parcel, mark), 0.0, 0.0
    value = potential(surface, parcel, mark, origin, z, w)
    for _ in range(200):
        count = gradient(surface, parcel, mark, origin, z, w, hessian, slope)
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
            following = potential(surface, parcel, mark, origin, trial, w)
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
        if mem[i, mark] != at.ABSENT:
            _, _, n = pressed(surface, parcel, z, origin, mem[i, at.CELL])
            mem[i, mark] = at.ACTIVE if n > 0.0 else at.LIFTED


@kernel
def violated(surface, parcel, seg, mark):
    """True where a cell marked as loaded would pull, or one marked as lifted would be pressed."""
    sx, sy = shift(surface, mark - at.MARK)
    a0, bx, by = plane_at(surface, seg, sx - seg[at.CX], sy - seg[at.CY])
    zero = negligible(surface, a0)
    for i in range(parcel.ctl[at.N_MEMBERS]):
        state = parcel.mem[i, mark]
        if state == at.ABSENT:
            continue
        cell = parcel.mem[i, at.CELL]
        rx = surface.pos[cell, 0] - parcel.y[0] - seg[at.CX]
        ry = surface.pos[cell, 1] - parcel.y[1] - seg[at.CY]
        n = a0 + bx * rx + by * ry - gap(surface, cell)
        if state == at.ACTIVE and n < -zero:
            return True
        if state == at.LIFTED and n > zero:
            # on a line of supports the plane may tilt about the line: cells beside it stay clear
            if seg[at.RANK] == 2:
                return True
            if seg[at.RANK] == 1 and abs(seg[at.LINE_X] * rx + seg[at.LINE_Y] * ry) <= parcel.par[at.ON_LINE]:
                return True
    return False


@kernel
def exchange(surface, parcel, seg, mark):
    """Toggle the support mark that contradicts its computed load most.

    ``contact`` finds the supports to the rounding of its potential, half the digits of a load; loads nearer to zero
    than that are sorted out here, one by one.
    """
    sx, sy = shift(surface, mark - at.MARK)
    a0, bx, by = plane_at(surface, seg, sx - seg[at.CX], sy - seg[at.CY])
    mem = parcel.mem
    worst, which = 0.0, -1
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if mem[i, mark] != at.ABSENT:
            cell = mem[i, at.CELL]
            rx = surface.pos[cell, 0] - parcel.y[0] - seg[at.CX]
            ry = surface.pos[cell, 1] - parcel.y[1] - seg[at.CY]
            n = a0 + bx * rx + by * ry - gap(surface, cell)
            wrong = -n if mem[i, mark] == at.ACTIVE else n
            if wrong > worst:
                worst, which = wrong, i
    if which >= 0:
        mem[which, mark] = at.LIFTED if mem[which, mark] == at.ACTIVE else at.ACTIVE


@kernel
def stands(surface, parcel, seg, mark):
    """Whether supports that span no plane carry the parcel. Returns (tipped, off their line)."""
    ctl, (sx, sy) = parcel.ctl, shift(surface, mark - at.MARK)
    centre = (parcel.y[0] + sx, parcel.y[1] + sy)
    distance, a, b = outside_hull(surface.pos, parcel.mem, ctl, centre, parcel.par[at.PITCH], mark)
    ctl[at.TIP_A], ctl[at.TIP_B] = a, b
    if distance > parcel.par[at.ON_LINE]:
        return True, False
    cx, cy = seg[at.CX] - sx, seg[at.CY] - sy
    off = abs(seg[at.LINE_X] * cx + seg[at.LINE_Y] * cy)
    if seg[at.RANK] == 0:
        off = (cx * cx + cy * cy) ** 0.5
    return False, off > parcel.par[at.ON_LINE]


@kernel
def press_all(parcel, mark):
    """Mark every cell of a mode as carrying load. Returns how many there are."""
    count = at.ZERO
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if parcel.mem[i, mark] != at.ABSENT:
            parcel.mem[i, mark] = at.ACTIVE
            count += 1
    return count


@kernel
def settle(surface, parcel, seg, mark, scratch, newton):
    """Find which cells carry load in one mode at this instant, and the constants of that support set into ``seg``.

    Tries what stands first; where a load would pull, solves the contact problem, until nothing changes. Returns the
    status; with TIPPED the edge is in ``ctl``.
    """
    near = False
    for attempt in range(40):
        segment(surface, parcel, seg, mark)
        if seg[at.N_ACTIVE] == 0:
            if press_all(parcel, mark) == 0:
                parcel.ctl[at.TIP_A] = parcel.ctl[at.TIP_B] = at.NO_CELL
                return at.TIPPED
            segment(surface, parcel, seg, mark)
        if seg[at.RANK] < 2:
            tipped, off_line = stands(surface, parcel, seg, mark)
            # past a corner of the hull by more than past either edge: no set of loads is better than this one
            if tipped or (off_line and near):
                return at.TIPPED
            if off_line:
                near = True
                contact(surface, parcel, seg, mark, scratch, newton)
                continue
        if not violated(surface, parcel, seg, mark):
            return at.MOVING
        if seg[at.RANK] == 2 and stands(surface, parcel, seg, mark)[0]:
            return at.TIPPED
        if near and attempt % 10 != 9:
            exchange(surface, parcel, seg, mark)
        else:
            contact(surface, parcel, seg, mark, scratch, newton)
            near = True
    return at.NO_LOADS


@kernel
def settle_mode(surface, parcel, work, m):
    """As ``settle``, of mode m; with no shift of its loads where none balance with the one that stands."""
    seg, mark = work.segs[m], at.MARK + m
    status = settle(surface, parcel, seg, mark, work.scratch, work.newton)
    if status == at.TIPPED and unshift(surface, m):
        # the traction that shifted the loads may be gone
        status = settle(surface, parcel, seg, mark, work.scratch, work.newton)
    return status
