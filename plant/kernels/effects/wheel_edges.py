"""Wheels that have a width (effect ``contact_width``): a cell's stiffness ramps as it crosses the footprint's edge.

Only a solver whose scene asks for it imports this; kernels for wheels without width are compiled without it.

A cell whose centre is ``d`` inside an edge counts by ``u^2 (3 - 2 u)``, ``u = 1/2 + d / width`` within [0, 1]: nothing
where the wheel just touches the edge, one half where its middle is on it. Beside a corner the factors of both edges
count: the nearest alone would have a kink where another becomes the nearest.
"""

from __future__ import annotations

from plant.kernels.common import layout as at
from plant.kernels.common.hooks import implements
from plant.kernels.common.springs import edges_under, overlap, reach, smooth, touches
from plant.kernels.common.surface import Edges

NOTHING = 1e-12
"""A share that carries no load to rounding."""


@implements(edges_under, "edges", own=True)
def _own(surface, i):
    return Edges(surface.edges.width_m, surface.edges.share[i])


@implements(reach, "edges", own=True)
def _half_a_wheel(surface):
    return 0.5 * surface.edges.width_m


@implements(touches, "edges", own=True)
def _weigh(surface, parcel, slot, c, s):
    cell, normal, offset = parcel.mem[slot, at.CELL], parcel.normal, parcel.offset
    dx, dy = surface.pos[cell, 0] - parcel.y[0], surface.pos[cell, 1] - parcel.y[1]
    qx, qy = c * dx + s * dy, -s * dx + c * dy
    share = 1.0
    for edge in range(offset.shape[0]):
        depth = offset[edge] - normal[edge, 0] * qx - normal[edge, 1] * qy
        u = max(0.0, min(1.0, 0.5 + depth / surface.edges.width_m))
        share *= u * u * (3.0 - 2.0 * u)
    surface.edges.share[slot] = share
    return share > NOTHING


@implements(overlap, "edges", own=True)
def _share(surface, slot):
    return surface.edges.share[slot]


@implements(smooth, "edges", own=True)
def _ramps(_surface):
    return True
