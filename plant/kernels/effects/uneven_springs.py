"""Springs of their own rates and heights (effect ``uneven_supports``): ``N_i = K_i (z(p_i) + h_i)+``, z the sag.

Only a solver whose scene asks for it imports this; kernels for equal springs are compiled without it.

In shares of the weight W, with the mean rate K: ``N_i / W = k_i (z - g_i)+`` where ``k_i = K_i / K``, and the sag z and
the gap ``g_i = -h_i`` are lengths over ``W / K``. On the supports S, with their centroid weighted by k,

    z = a + b . r     a = (1 + sum k g) / sum k     b = (sum k r r')^-1 (X - c + sum k g r)
"""

from __future__ import annotations

from plant.kernels.common import layout as at
from plant.kernels.common.hooks import implements
from plant.kernels.common.springs import (
    LOAD_ZERO,
    gap,
    negligible,
    note_gaps,
    plane_at,
    rate,
    springs_under,
    stiffness,
)
from plant.kernels.common.surface import Springs


@implements(springs_under, "springs", own=True)
def _own(surface, i):
    of = surface.springs
    return Springs(of.rate, of.gap_m, of.per_m[i], of.span[i], of.moments[i])


@implements(rate, "springs", own=True)
def _rate(surface, cell):
    return surface.springs.rate[cell]


@implements(gap, "springs", own=True)
def _gap(surface, cell):
    return surface.springs.per_m * surface.springs.gap_m[cell]


@implements(note_gaps, "springs", own=True)
def _moments(surface, parcel, seg, mark):
    moments, mem, y = surface.springs.moments, parcel.mem, parcel.y
    moments[0] = moments[1] = moments[2] = 0.0
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if mem[i, mark] == at.ACTIVE:
            cell = mem[i, at.CELL]
            pulled = stiffness(surface, cell, i) * gap(surface, cell)
            moments[0] += pulled
            moments[1] += pulled * (surface.pos[cell, 0] - y[0] - seg[at.CX])
            moments[2] += pulled * (surface.pos[cell, 1] - y[1] - seg[at.CY])


@implements(plane_at, "springs", own=True)
def _plane(surface, seg, mx, my):
    moments = surface.springs.moments
    tx, ty = mx + moments[1], my + moments[2]
    bx, by = seg[at.PXX] * tx + seg[at.PXY] * ty, seg[at.PXY] * tx + seg[at.PYY] * ty
    return (1.0 + moments[0]) / seg[at.N_ACTIVE], bx, by


@implements(negligible, "springs", own=True)
def _of_the_span(surface, a0):
    return LOAD_ZERO * (1.0 + abs(a0) + surface.springs.span)
