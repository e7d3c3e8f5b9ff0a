"""Constants of one support set: centroid, the plane of the springs, sums over what its wheels resist and drive with.

Loads are affine in the load centre (eqs. 3-13): ``N_i / W = a + b . (p_i - c)`` with ``a = 1 / n`` and
``b = (sum r r')^-1 (X - c)``. On the branches of the law that its wheels are on, force and torque on the parcel are
therefore linear in (a, b), with the sums below as coefficients (eqs. 16-23 with loads kept general). What doesn't
depend on the load (eq. 27) is a constant beside them; as a is one too, n times it is added to the coefficient of a.
"""

from __future__ import annotations

from math import inf

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.springs import note_gaps, stiffness
from plant.kernels.common.wheel_direction import direction


@kernel
def segment(surface, parcel, seg, mark):
    """Stiffness, centroid and inverse second moment of the active supports, with its rank, and their gaps."""
    pos, mem, ctl, y = surface.pos, parcel.mem, parcel.ctl, parcel.y
    total, cx, cy = 0.0, 0.0, 0.0
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, mark] == at.ACTIVE:
            cell = mem[i, at.CELL]
            k = stiffness(surface, cell, i)
            total += k
            cx += k * (pos[cell, 0] - y[0])
            cy += k * (pos[cell, 1] - y[1])
    seg[at.N_ACTIVE] = total
    if total == 0.0:
        seg[at.RANK] = -1
        return
    cx /= total
    cy /= total
    seg[at.CX], seg[at.CY] = cx, cy
    xx, xy, yy = 0.0, 0.0, 0.0
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, mark] == at.ACTIVE:
            cell = mem[i, at.CELL]
            k = stiffness(surface, cell, i)
            rx = pos[cell, 0] - y[0] - cx
            ry = pos[cell, 1] - y[1] - cy
            xx += k * rx * rx
            xy += k * rx * ry
            yy += k * ry * ry
    invert_symmetric(xx, xy, yy, total, parcel.par[at.ON_LINE], seg)
    note_gaps(surface, parcel, seg, mark)


@kernel
def invert_symmetric(xx, xy, yy, total, on_line, seg):
    """(Pseudo-)inverse of ``[[xx, xy], [xy, yy]]``: rank 1 where the supports lie on a line, 0 where on a point."""
    mean, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    spread = (half * half + xy * xy) ** 0.5
    large = mean + spread
    zero = total * on_line * on_line * 1e-6
    if large <= zero:
        seg[at.PXX] = seg[at.PXY] = seg[at.PYY] = 0.0
        seg[at.RANK] = 0
        return
    determinant = xx * yy - xy * xy
    # on a slanting line the two products cancel to rounding, not to zero
    if determinant > large * max(zero, 1e-12 * large):
        seg[at.PXX], seg[at.PXY], seg[at.PYY] = yy / determinant, -xy / determinant, xx / determinant
        seg[at.RANK] = 2
        return
    # direction of the line: the eigenvector of the large eigenvalue, from the better conditioned row
    dx, dy = (half + spread, xy) if half >= 0.0 else (xy, spread - half)
    size = (dx * dx + dy * dy) ** 0.5
    dx /= size
    dy /= size
    seg[at.PXX], seg[at.PXY], seg[at.PYY] = dx * dx / large, dx * dy / large, dy * dy / large
    seg[at.RANK] = 1
    seg[at.LINE_X], seg[at.LINE_Y] = -dy, dx


@kernel
def resistance(branch, constant, share):
    """A driven wheel's resistance to slip, over ``KAPPA``: (the coefficient of a, the part per share alone)."""
    return (constant, share) if branch == 0 else (0.0, 0.0)


@kernel
def slopes(par, seg):
    """Compute coefficients of ``resistance`` for a wheel within its limit: (of a, of the part per share alone)."""
    return par[at.PER_SHARE] + seg[at.N_ACTIVE] * par[at.CONSTANT], par[at.PER_SHARE]


@kernel
def set_sum(seg, first, a, x, y):
    """Set the three coefficients of a sum."""
    seg[first], seg[first + 1], seg[first + 2] = a, x, y


@kernel
def add_to_sum(seg, first, a, x, y):
    """Add to the three coefficients of a sum."""
    seg[first] += a
    seg[first + 1] += x
    seg[first + 2] += y


@kernel
def turning(pos, grip, mem, ctl, y, par, seg, m):
    """Resistance of mode m's driven wheels to turning about the centroid, ``C2``, and whether it is ``UNIFORM``."""
    whole, share = slopes(par, seg)
    total = total_x = total_y = 0.0
    uniform = 1.0 if whole == 1.0 and share == 1.0 else 0.0
    for i in range(ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        if mem[i, at.MARK + m] != at.ACTIVE:
            continue
        if grip[cell] == 0.0:
            uniform = 0.0
            continue
        bx, by = mem[i, at.BRANCH + 2 * m], mem[i, at.BRANCH + 2 * m + 1]
        if bx != 0 or by != 0:
            uniform = 0.0
        wx, share_x = resistance(bx, whole, share)
        wy, share_y = resistance(by, whole, share)
        rx, ry = pos[cell, 0] - y[0] - seg[at.CX], pos[cell, 1] - y[1] - seg[at.CY]
        square = share_y * (rx * rx) + share_x * (ry * ry)
        total += wy * (rx * rx) + wx * (ry * ry)
        total_x += square * rx
        total_y += square * ry
    seg[at.UNIFORM] = uniform
    set_sum(seg, at.C2, total, total_x, total_y)


@kernel
def resistances(pos, grip, mem, ctl, y, par, seg, m):
    """Sums of what mode m's driven wheels resist slip with, and of its moments: ``seg`` from ``S0X`` to ``S1Y``."""
    whole, share = slopes(par, seg)
    x0 = x0x = x0y = y0 = y0x = y0y = x1 = x1x = x1y = y1 = y1x = y1y = 0.0
    for i in range(ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        if mem[i, at.MARK + m] != at.ACTIVE or grip[cell] == 0.0:
            continue
        wx, share_x = resistance(mem[i, at.BRANCH + 2 * m], whole, share)
        wy, share_y = resistance(mem[i, at.BRANCH + 2 * m + 1], whole, share)
        rx, ry = pos[cell, 0] - y[0] - seg[at.CX], pos[cell, 1] - y[1] - seg[at.CY]
        x0 += wx
        x0x += share_x * rx
        x0y += share_x * ry
        y0 += wy
        y0x += share_y * rx
        y0y += share_y * ry
        x1 += wx * ry
        x1x += share_x * rx * ry
        x1y += share_x * ry * ry
        y1 += wy * rx
        y1x += share_y * rx * rx
        y1y += share_y * rx * ry
    set_sum(seg, at.S0X, x0, x0x, x0y)
    set_sum(seg, at.S0Y, y0, y0x, y0y)
    set_sum(seg, at.S1X, x1, x1x, x1y)
    set_sum(seg, at.S1Y, y1, y1x, y1y)


@kernel
def drives(pos, velocity, grip, mem, ctl, y, par, seg, m, base):
    """Sums of what mode m's driven wheels drive with by a part of their speed, ``velocity``: ``seg`` from ``base``."""
    whole, share = slopes(par, seg)
    free = par[at.FREE_SPEED]
    x0 = xx = xy = y0 = yx = yy = turn = turn_x = turn_y = 0.0
    for i in range(ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        if mem[i, at.MARK + m] != at.ACTIVE or grip[cell] == 0.0:
            continue
        wx, share_x = resistance(mem[i, at.BRANCH + 2 * m], whole, share)
        wy, share_y = resistance(mem[i, at.BRANCH + 2 * m + 1], whole, share)
        vx, vy = free * velocity[cell, 0], free * velocity[cell, 1]
        fx, fy, share_x, share_y = wx * vx, wy * vy, share_x * vx, share_y * vy
        rx, ry = pos[cell, 0] - y[0] - seg[at.CX], pos[cell, 1] - y[1] - seg[at.CY]
        lever = rx * share_y - ry * share_x
        x0 += fx
        xx += share_x * rx
        xy += share_x * ry
        y0 += fy
        yx += share_y * rx
        yy += share_y * ry
        turn += rx * fy - ry * fx
        turn_x += lever * rx
        turn_y += lever * ry
    set_sum(seg, base + at.DX, x0, xx, xy)
    set_sum(seg, base + at.DY, y0, yx, yy)
    set_sum(seg, base + at.T, turn, turn_x, turn_y)


@kernel
def push(par, branch, count, steady, decay, e):
    """Compute the slip-independent pull of a driven wheel over ``KAPPA``: (the coefficient of a, the part per share).

    The pull applies at the wheel's limit, and along its running direction (eq. 24) at the speed ``steady + e decay``.
    """
    share = branch * par[at.LIMIT_PER_SHARE]
    if par[at.PUSH_PER_SHARE] != 0.0:
        share += par[at.PUSH_PER_SHARE] * direction(steady, decay, e)
    return share + count * branch * par[at.LIMIT] if branch != 0 else share, share


@kernel
def pushes(pos, steady, decay, grip, mem, ctl, y, par, seg, m, e):
    """Add what mode m's driven wheels pull with whatever the slip to the steady part of what they drive with."""
    base = at.STEADY
    for i in range(ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        if mem[i, at.MARK + m] != at.ACTIVE or grip[cell] == 0.0:
            continue
        bx, by, count = mem[i, at.BRANCH + 2 * m], mem[i, at.BRANCH + 2 * m + 1], seg[at.N_ACTIVE]
        fx, share_x = push(par, bx, count, steady[cell, 0], decay[cell, 0], e)
        fy, share_y = push(par, by, count, steady[cell, 1], decay[cell, 1], e)
        rx, ry = pos[cell, 0] - y[0] - seg[at.CX], pos[cell, 1] - y[1] - seg[at.CY]
        lever = rx * share_y - ry * share_x
        add_to_sum(seg, base + at.DX, fx, share_x * rx, share_x * ry)
        add_to_sum(seg, base + at.DY, fy, share_y * rx, share_y * ry)
        add_to_sum(seg, base + at.T, rx * fy - ry * fx, lever * rx, lever * ry)


@kernel
def moments(surface, parcel, seg, m, e, mixes):
    """All sums over mode m's wheels, whose supports ``settle`` found; ``e`` is the motors' decay factor now.

    Where resistance is uniform, its sums are known, and are only gone through for a mode that mixes with others.
    """
    pos, grip, mem, ctl, y, par = surface.pos, surface.grip, parcel.mem, parcel.ctl, parcel.y, parcel.par
    turning(pos, grip, mem, ctl, y, par, seg, m)
    if mixes or seg[at.UNIFORM] == 0.0:
        resistances(pos, grip, mem, ctl, y, par, seg, m)
    drives(pos, surface.steady, grip, mem, ctl, y, par, seg, m, at.STEADY)
    if par[at.RATE] > 0.0:
        drives(pos, surface.decay, grip, mem, ctl, y, par, seg, m, at.DECAY)
    if par[at.PUSH_PER_SHARE] != 0.0 or par[at.LIMIT] < inf:
        pushes(pos, surface.steady, surface.decay, grip, mem, ctl, y, par, seg, m, e)
