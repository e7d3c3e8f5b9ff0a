"""Wheels that have a width (effect ``contact_width``): a cell's stiffness ramps as it crosses the footprint's edge.

Only a solver whose scene asks for it imports this; kernels for wheels without width are compiled without it.

A cell whose centre is ``d`` inside an edge counts by ``u^2 (3 - 2 u)``, ``u = 1/2 + d / width`` within [0, 1]: nothing
where the wheel just touches the edge, one half where its middle is on it. Beside a corner the factors of both edges
count: the nearest alone would have a kink where another becomes the nearest. A load's second derivative jumps where
its cell's wheel just touches an edge and where the wheel is wholly inside: steps that are located end at both.
"""

from __future__ import annotations

from math import cos, sin

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.events import edge_polynomial, negate, note, place
from plant.kernels.common.footprint import mitre
from plant.kernels.common.hooks import implements
from plant.kernels.common.roots import deflate, first_crossing
from plant.kernels.common.springs import (
    edges_under,
    inset,
    overlap,
    ramp_ends,
    ramps,
    reach,
    smooth,
    spread,
    touches,
    weigh,
)
from plant.kernels.common.surface import Edges

NOTHING = 1e-12
"""A share that carries no load to rounding."""


@implements(edges_under, "edges", own=True)
def _own(surface, i):
    return Edges(surface.edges.width_m, surface.edges.share[i])


@implements(reach, "edges", own=True)
def _half_a_wheel(surface):
    return 0.5 * surface.edges.width_m


@implements(inset, "edges", own=True)
def _outside(surface):
    return -reach(surface)


@implements(spread, "edges", own=True)
def _beyond_corners(surface, normal):
    return reach(surface) * mitre(normal)


@implements(weigh, "edges", own=True)
def _weigh_all(surface, parcel, h):
    y = parcel.y
    angle = y[at.THETA] + h * y[at.OMEGA]
    c, s = cos(angle), sin(angle)
    for i in range(parcel.ctl[at.N_MEMBERS]):
        surface.edges.share[i] = share_under(
            surface, parcel, i, (y[0] + h * y[at.UX], y[1] + h * y[at.UY]), c, s
        )


@implements(ramps, "edges", own=True)
def _beside_an_edge(surface, parcel):
    normal, offset, y = parcel.normal, parcel.offset, parcel.y
    c, s, near = cos(y[at.THETA]), sin(y[at.THETA]), reach(surface) + parcel.par[at.ON_SURFACE]
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = parcel.mem[i, at.CELL]
        dx, dy = surface.pos[cell, 0] - y[0], surface.pos[cell, 1] - y[1]
        qx, qy = c * dx + s * dy, -s * dx + c * dy
        for edge in range(offset.shape[0]):
            if abs(offset[edge] - normal[edge, 0] * qx - normal[edge, 1] * qy) <= near:
                return True
    return False


@implements(ramp_ends, "edges", own=True)
def _whole_wheels(surface, parcel, work, order, centre, lever, end, count):
    normal, offset, ser, g = parcel.normal, parcel.offset, work.ser, work.g
    zero, within = parcel.par[at.ON_SURFACE], reach(surface)
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = parcel.mem[i, at.CELL]
        px, py = surface.pos[cell, 0] - parcel.y[0], surface.pos[cell, 1] - parcel.y[1]
        curve = (centre + lever * (px * px + py * py) ** 0.5) * 1.000001
        qx, qy, dx, dy = place(ser, px, py)
        for edge in range(offset.shape[0]):
            nx, ny = normal[edge, 0], normal[edge, 1]
            value, rate = offset[edge] - within - nx * qx - ny * qy, -nx * dx - ny * dy
            if abs(value) > abs(rate) * end + curve * end * end + zero:
                continue
            edge_polynomial(ser, order, nx, ny, offset[edge] - within, px, py, g)
            degree, side = order, (1 if g[0] > 0.0 else -1)
            if abs(g[0]) <= zero:
                degree, side = deflate(g, order, zero)
            if side < 0:
                negate(g, degree)
            if side != 0:
                t = first_crossing(g, degree, end, work.p)
                if t <= end:
                    count, end = note(work.found, count, t, at.RAMP, cell, edge), t
    return count, end


@implements(touches, "edges", own=True)
def _weigh(surface, parcel, slot, c, s):
    share = share_under(surface, parcel, slot, (parcel.y[0], parcel.y[1]), c, s)
    surface.edges.share[slot] = share
    return share > NOTHING


@kernel
def share_under(surface, parcel, slot, centre, c, s):
    """Share of the cell in ``parcel.mem[slot]`` that is under the parcel with its centre of mass at ``centre``, m."""
    cell, normal, offset = parcel.mem[slot, at.CELL], parcel.normal, parcel.offset
    dx, dy = surface.pos[cell, 0] - centre[0], surface.pos[cell, 1] - centre[1]
    qx, qy = c * dx + s * dy, -s * dx + c * dy
    share = 1.0
    for edge in range(offset.shape[0]):
        depth = offset[edge] - normal[edge, 0] * qx - normal[edge, 1] * qy
        u = max(0.0, min(1.0, 0.5 + depth / surface.edges.width_m))
        share *= u * u * (3.0 - 2.0 * u)
    return share


@implements(overlap, "edges", own=True)
def _share(surface, slot):
    return surface.edges.share[slot]


@implements(smooth, "edges", own=True)
def _ramps(_surface):
    return True
