"""Contact impulses at touching points: non-penetration and friction.

One problem serves velocities (impulses in N s) and places (shifts times mass): bodies have a motion ``u`` of three
entries each, every point asks that the second body leaves the first along the normal by at least ``WANTED``, and may
push, never pull; across, it draws towards ``ASIDE_WANTED`` with what Coulomb's cone allows, or where ``HOLD`` is set
whatever it takes. Impulses are equal and opposite, so that momentum stays to rounding.
"""

from __future__ import annotations

from typing import Final

from plant.kernels.common import layout as at
from plant.kernels.common.jit import kernel
from plant.kernels.contact import layout as to
from plant.kernels.contact.active_set import solve_island
from plant.kernels.contact.problem import (
    apply_impulses,
    assemble,
    assemble_matrix,
    island_of,
    mark_islands,
    select_rows,
)

SOLVED: Final = 1e-13
"""Error of a problem's solution, over the fastest motion, at which the search ends."""
ACCEPTED: Final = 1e-12
"""Error of velocities above which another attempt is made."""
UNSETTLED: Final = 1e-9
"""Error above which a problem counts as not solved."""
TOO_LARGE: Final = 1.0
"""Error of an island that the workspace has no room for."""


@kernel
def along(row, x, y, u, v):
    """Compute the separation velocity of two bodies at a contact point along ``(x, y)``, m/s."""
    first = x * (u[0] - u[2] * row[to.AY]) + y * (u[1] + u[2] * row[to.AX])
    return x * (v[0] - v[2] * row[to.BY]) + y * (v[1] + v[2] * row[to.BX]) - first


@kernel
def leaving(row, u, v):
    """Compute the separation speed at a contact point along its normal, m/s."""
    return along(row, row[to.NORMAL_X], row[to.NORMAL_Y], u, v)


@kernel
def sliding(row, u, v):
    """Compute the relative speed at a contact point along its tangent, the normal turned by 90 degrees, m/s."""
    return along(row, -row[to.NORMAL_Y], row[to.NORMAL_X], u, v)


@kernel
def settle(work, count, inverse, motion, accepted):
    """Solve the contact problems of all islands, and change ``motion`` by their impulses.

    Args:
        work: ``plant.effects.parcel_contact.bodies.ContactWorkspace``, with ``count`` rows.
        count: how many rows.
        inverse: ``(b, 2)`` one over mass and over moment of inertia; 0, 0 for what can't be moved.
        motion: ``(b, 3)`` along x, along y, turning; changed in place.
        accepted: error, over the fastest motion, above which another attempt is made.

    Returns:
        The largest error left in an island, over the island's fastest motion.
    """
    worst, island = at.NOTHING, work.impulses
    mark_islands(work.ends, count, inverse, island.leader)
    for n in range(count):
        here = island_of(work.ends, n, inverse, island.leader)
        first = True
        for k in range(n):
            if island_of(work.ends, k, inverse, island.leader) == here:
                first = False
                break
        if not first:
            continue
        points, faces = select_rows(work.ends, count, inverse, here, island)
        if points + faces > island.lacking.shape[0]:
            return TOO_LARGE
        scale = assemble(work.rows, work.ends, points, faces, motion, island)
        if scale > 0.0:
            assemble_matrix(points + faces, inverse, island)
            error = solve_island(points, faces, SOLVED * scale, accepted * scale, island)
            apply_impulses(points + faces, inverse, motion, island)
            worst = max(worst, error / scale)
    return worst
