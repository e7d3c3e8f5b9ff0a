"""Constants of one support set: centroid, the plane of the springs, moments of load and wheel velocity.

Loads are affine in the load centre (eqs. 3-13): ``N_i / W = a + b . (p_i - c)`` with ``a = 1 / n`` and
``b = (sum r r')^-1 (X - c)``. Force and torque on the parcel are therefore linear in (a, b), with the moments below as
coefficients (eqs. 16-23 with loads kept general).
"""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel
from plant.kernels.springs import note_gaps, stiffness


@kernel
def centre_and_plane(surface, parcel, seg, mark):
    """Stiffness, centroid and inverse second moment of the active supports, with its rank, and their gaps."""
    pos, mem, ctl, y = surface.pos, parcel.mem, parcel.ctl, parcel.y
    total, cx, cy = 0.0, 0.0, 0.0
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, mark] == at.ACTIVE:
            cell = mem[i, at.CELL]
            k = stiffness(surface, cell)
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
            k = stiffness(surface, cell)
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
def wheel_moments(pos, velocity, grip, mem, ctl, y, seg, mark, base):
    """Moments of the driven wheels' velocity over the active supports, into ``seg[base:base + 9]``."""
    for k in range(9):
        seg[base + k] = 0.0
    for i in range(ctl[at.N_MEMBERS]):
        if mem[i, mark] == at.ACTIVE:
            cell = mem[i, at.CELL]
            w = grip[cell]
            vx, vy = w * velocity[cell, 0], w * velocity[cell, 1]
            rx = pos[cell, 0] - y[0] - seg[at.CX]
            ry = pos[cell, 1] - y[1] - seg[at.CY]
            turn = rx * vy - ry * vx
            seg[base + at.K0X] += vx
            seg[base + at.K0Y] += vy
            seg[base + at.K1XX] += vx * rx
            seg[base + at.K1XY] += vx * ry
            seg[base + at.K1YX] += vy * rx
            seg[base + at.K1YY] += vy * ry
            seg[base + at.T0] += turn
            seg[base + at.T1X] += turn * rx
            seg[base + at.T1Y] += turn * ry


@kernel
def load_moments(pos, grip, mem, ctl, y, seg, mark):
    """Moments of the driven wheels themselves; where every wheel is driven several vanish exactly."""
    for k in range(at.W0, at.G1Y + 1):
        seg[k] = 0.0
    seg[at.DRIVEN] = 1.0
    for i in range(ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        w = grip[cell]
        if w != 1.0:
            seg[at.DRIVEN] = 0.0
        if mem[i, mark] == at.ACTIVE:
            rx = pos[cell, 0] - y[0] - seg[at.CX]
            ry = pos[cell, 1] - y[1] - seg[at.CY]
            square = rx * rx + ry * ry
            seg[at.W0] += w
            seg[at.W1X] += w * rx
            seg[at.W1Y] += w * ry
            seg[at.W2XX] += w * rx * rx
            seg[at.W2XY] += w * rx * ry
            seg[at.W2YY] += w * ry * ry
            seg[at.G0] += w * square
            seg[at.G1X] += w * square * rx
            seg[at.G1Y] += w * square * ry


@kernel
def segment(surface, parcel, seg, mark):
    """All constants of the support set whose marks are in column ``mark`` of ``parcel.mem``."""
    pos, grip, mem, ctl, y, par = surface.pos, surface.grip, parcel.mem, parcel.ctl, parcel.y, parcel.par
    centre_and_plane(surface, parcel, seg, mark)
    load_moments(pos, grip, mem, ctl, y, seg, mark)
    wheel_moments(pos, surface.steady, grip, mem, ctl, y, seg, mark, at.STEADY)
    if par[at.RATE] > 0.0:
        wheel_moments(pos, surface.decay, grip, mem, ctl, y, seg, mark, at.DECAY)
