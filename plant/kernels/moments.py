"""Constants of one support set: centroid, the plane of the springs, moments of load and wheel velocity.

Loads are affine in the load centre (eqs. 3-13): ``N_i / W = a + b . (p_i - c)`` with ``a = (1 - sum f) / n`` and
``b = (sum r r')^-1 (X - c - sum f r)``, where f are the loads of captured cells. Force and torque on the parcel
are therefore linear in (a, b, f), with the moments below as coefficients (eqs. 16-23 with loads kept general).
"""

from __future__ import annotations

from plant.kernels.jit import kernel
from plant.kernels.layout import (
    ACTIVE,
    CAPTURED,
    CELL,
    CX,
    CY,
    DECAY,
    DRIVEN,
    G0,
    G1X,
    G1Y,
    GROUP,
    GRP_SIZE,
    K0X,
    K0Y,
    K1XX,
    K1XY,
    K1YX,
    K1YY,
    LINE_X,
    LINE_Y,
    MARK,
    N_ACTIVE,
    N_GROUPS,
    N_MEMBERS,
    ON_LINE,
    PXX,
    PXY,
    PYY,
    RANK,
    RATE,
    S_BX,
    S_BY,
    S_RB,
    S_RV,
    S_RX,
    S_RY,
    S_VX,
    S_VY,
    S_W,
    S_WRR,
    S_WRX,
    S_WRY,
    STEADY,
    T0,
    T1X,
    T1Y,
    W0,
    W1X,
    W1Y,
    W2XX,
    W2XY,
    W2YY,
)  # fmt: skip


@kernel
def centre_and_plane(pos, mem, ctl, y, par, seg):
    """Number, centroid and inverse second moment of the active supports, with its rank."""
    count = 0
    cx, cy = 0.0, 0.0
    for i in range(ctl[N_MEMBERS]):
        if mem[i, MARK] == ACTIVE:
            cell = mem[i, CELL]
            count += 1
            cx += pos[cell, 0] - y[0]
            cy += pos[cell, 1] - y[1]
    seg[N_ACTIVE] = count
    if count == 0:
        seg[RANK] = -1
        return
    cx /= count
    cy /= count
    seg[CX], seg[CY] = cx, cy
    xx, xy, yy = 0.0, 0.0, 0.0
    for i in range(ctl[N_MEMBERS]):
        if mem[i, MARK] == ACTIVE:
            cell = mem[i, CELL]
            rx = pos[cell, 0] - y[0] - cx
            ry = pos[cell, 1] - y[1] - cy
            xx += rx * rx
            xy += rx * ry
            yy += ry * ry
    invert_symmetric(xx, xy, yy, count, par[ON_LINE], seg)


@kernel
def invert_symmetric(xx, xy, yy, count, on_line, seg):
    """(Pseudo-)inverse of ``[[xx, xy], [xy, yy]]``: rank 1 where the supports lie on a line, 0 where on a point."""
    mean, half = 0.5 * (xx + yy), 0.5 * (xx - yy)
    spread = (half * half + xy * xy) ** 0.5
    large = mean + spread
    zero = count * on_line * on_line * 1e-6
    if large <= zero:
        seg[PXX] = seg[PXY] = seg[PYY] = 0.0
        seg[RANK] = 0
        return
    determinant = xx * yy - xy * xy
    if determinant > large * zero:
        seg[PXX], seg[PXY], seg[PYY] = yy / determinant, -xy / determinant, xx / determinant
        seg[RANK] = 2
        return
    # direction of the line: the eigenvector of the large eigenvalue, from the better conditioned row
    dx, dy = (half + spread, xy) if half >= 0.0 else (xy, spread - half)
    size = (dx * dx + dy * dy) ** 0.5
    dx /= size
    dy /= size
    seg[PXX], seg[PXY], seg[PYY] = dx * dx / large, dx * dy / large, dy * dy / large
    seg[RANK] = 1
    seg[LINE_X], seg[LINE_Y] = -dy, dx


@kernel
def wheel_moments(pos, velocity, grip, mem, ctl, y, seg, base):
    """Moments of the driven wheels' velocity over the active supports, into ``seg[base:base + 9]``."""
    for k in range(9):
        seg[base + k] = 0.0
    for i in range(ctl[N_MEMBERS]):
        if mem[i, MARK] == ACTIVE:
            cell = mem[i, CELL]
            w = grip[cell]
            vx, vy = w * velocity[cell, 0], w * velocity[cell, 1]
            rx = pos[cell, 0] - y[0] - seg[CX]
            ry = pos[cell, 1] - y[1] - seg[CY]
            turn = rx * vy - ry * vx
            seg[base + K0X] += vx
            seg[base + K0Y] += vy
            seg[base + K1XX] += vx * rx
            seg[base + K1XY] += vx * ry
            seg[base + K1YX] += vy * rx
            seg[base + K1YY] += vy * ry
            seg[base + T0] += turn
            seg[base + T1X] += turn * rx
            seg[base + T1Y] += turn * ry


@kernel
def load_moments(pos, grip, mem, ctl, y, seg):
    """Moments of the driven wheels themselves; where every wheel is driven several vanish exactly."""
    for k in range(W0, G1Y + 1):
        seg[k] = 0.0
    seg[DRIVEN] = 1.0
    for i in range(ctl[N_MEMBERS]):
        cell = mem[i, CELL]
        w = grip[cell]
        if w != 1.0:
            seg[DRIVEN] = 0.0
        if mem[i, MARK] == ACTIVE:
            rx = pos[cell, 0] - y[0] - seg[CX]
            ry = pos[cell, 1] - y[1] - seg[CY]
            square = rx * rx + ry * ry
            seg[W0] += w
            seg[W1X] += w * rx
            seg[W1Y] += w * ry
            seg[W2XX] += w * rx * rx
            seg[W2XY] += w * rx * ry
            seg[W2YY] += w * ry * ry
            seg[G0] += w * square
            seg[G1X] += w * square * rx
            seg[G1Y] += w * square * ry


@kernel
def group_moments(pos, steady, decay, grip, mem, share, ctl, y, seg, grp):
    """What a unit load on each captured group contributes, about the centroid of the active supports."""
    for h in range(ctl[N_GROUPS]):
        for k in range(GRP_SIZE):
            grp[h, k] = 0.0
    for i in range(ctl[N_MEMBERS]):
        if mem[i, MARK] != CAPTURED:
            continue
        h, cell, s = mem[i, GROUP], mem[i, CELL], share[i]
        w = s * grip[cell]
        rx = pos[cell, 0] - y[0] - seg[CX]
        ry = pos[cell, 1] - y[1] - seg[CY]
        grp[h, S_RX] += s * rx
        grp[h, S_RY] += s * ry
        grp[h, S_W] += w
        grp[h, S_WRX] += w * rx
        grp[h, S_WRY] += w * ry
        grp[h, S_WRR] += w * (rx * rx + ry * ry)
        grp[h, S_VX] += w * steady[cell, 0]
        grp[h, S_VY] += w * steady[cell, 1]
        grp[h, S_RV] += w * (rx * steady[cell, 1] - ry * steady[cell, 0])
        grp[h, S_BX] += w * decay[cell, 0]
        grp[h, S_BY] += w * decay[cell, 1]
        grp[h, S_RB] += w * (rx * decay[cell, 1] - ry * decay[cell, 0])


@kernel
def segment(pos, steady, decay, grip, mem, share, ctl, y, par, seg, grp):
    """All constants of the present support set."""
    centre_and_plane(pos, mem, ctl, y, par, seg)
    load_moments(pos, grip, mem, ctl, y, seg)
    wheel_moments(pos, steady, grip, mem, ctl, y, seg, STEADY)
    if par[RATE] > 0.0:
        wheel_moments(pos, decay, grip, mem, ctl, y, seg, DECAY)
    if ctl[N_GROUPS] > 0:
        group_moments(pos, steady, decay, grip, mem, share, ctl, y, seg, grp)
