"""Contact impulses at touching points: non-penetration and friction.

One problem serves velocities (impulses in N s) and places (shifts times mass): bodies have a motion ``u`` of three
entries each, every point asks that the second body leaves the first along the normal by at least ``WANTED``, and may
push, never pull; across, it draws towards ``ASIDE_WANTED`` with what Coulomb's cone allows, or where ``HOLD`` is set
whatever it takes. Impulses are equal and opposite, so that momentum stays to rounding.
"""

from __future__ import annotations

from typing import Final

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.contact import layout as to
from plant.kernels.contact.active_set import LIGHTEST, PROXIMAL, improve, sweep
from plant.kernels.contact.linear import order_faces
from plant.kernels.contact.pivoting import pivot
from plant.kernels.contact.problem import (
    apply_impulses,
    assemble,
    face_of,
    number_faces,
    sort_islands,
)

SOLVED: Final = 1e-13
"""Error of a problem's solution, over the fastest motion, at which the search ends."""
ACCEPTED: Final = 1e-12
"""Error of velocities above which another attempt is made."""
TOLERATED: Final = 1e-8
"""Error with friction above which another attempt is made: edges are known to a nanometre only, which for
boxes is an angle of as much, and what differs by as little can't be told apart."""
MOVED: Final = (1e-10, 1e-8)
"""How much constants are moved for Lemke's method, over the largest."""
UNSETTLED: Final = 1e-7
"""Error above which a problem counts as not solved: it is solved without friction instead."""
SWEEPS: Final = (2, 10, 40, 160, 640)
"""Sweeps before the first attempts without impulses to start from."""
LAST_SWEEPS: Final = 200
LAST_SHARE: Final = 0.5
"""Sweeps of the last attempt, and their damping: strong friction at several points can go in circles."""


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
def attempt(count, faces, enough, lightest, best, inverse, work):
    """Take Newton steps from ``work.trial``; keep in ``work.impulse`` what beats ``best``. Returns the least error."""
    error = improve(count, faces, work.trial, enough, lightest, inverse, work)
    if error < best:
        best = error
        for c in range(count + faces):
            work.impulse[c] = work.trial[c]
    return best


@kernel
def search(count, faces, enough, accepted, inverse, work):
    """Try one method after another, from ``work.impulse`` on, until the error is ``accepted``. Returns the least error.

    Newton steps begin at the given impulses, at those of a few sweeps, then of more, at Lemke's, and at those of
    damped sweeps. ``work.impulse`` ends as the best of all. Errors are motions.
    """
    size, given, best = count + faces, False, 1e300
    for c in range(size):
        given = given or work.impulse[c] != 0.0
        work.start[c] = 0.0
        work.trial[c] = work.impulse[c]
    if given:
        best = attempt(count, faces, enough, LIGHTEST, best, inverse, work)
    for k in range(len(SWEEPS)):
        if best <= accepted:
            return best
        sweep(count, faces, work.start, SWEEPS[k], 1.0, inverse, work)
        for c in range(size):
            work.trial[c] = work.start[c]
        # where light weights lead in circles, the first weight may not
        best = attempt(count, faces, enough, PROXIMAL if k % 2 == 1 else LIGHTEST, best, inverse, work)
    if best > accepted:
        work.tally[to.PIVOTED] += 1
        for moved in MOVED:
            if best > accepted and pivot(count, faces, work.trial, work.table, moved, inverse, work):
                best = attempt(count, faces, enough, LIGHTEST, best, inverse, work)
    if best > accepted:
        work.tally[to.SWEPT] += 1
        sweep(count, faces, work.start, LAST_SWEEPS, LAST_SHARE, inverse, work)
        for c in range(size):
            work.trial[c] = work.start[c]
        best = attempt(count, faces, enough, LIGHTEST, best, inverse, work)
    return best


@kernel
def solve_island(count, faces, scale, enough, accepted, inverse, work):
    """Find the impulses of an assembled island, ``work.impulse``, from those in it on.

    Where no method finds them with friction, they are those without.

    Args:
        count: number of normals.
        faces: number of faces.
        scale: fastest motion in the problem.
        enough: error, over the fastest motion, at which the search ends.
        accepted: the same, above which another attempt is made; with friction it is `TOLERATED` at least.
        inverse: ``(b, 2)`` one over mass and over moment of inertia.
        work: workspace with an assembled island.

    Returns:
        The error of the impulses, as a motion.
    """
    order_faces(faces, inverse, work)
    rubs = False
    for f in range(faces):
        rubs = rubs or work.friction[f] > 0.0
    tolerated = max(accepted, TOLERATED) if rubs else accepted
    best = search(count, faces, enough * scale, tolerated * scale, inverse, work)
    if rubs and best > UNSETTLED * scale:
        # without friction the problem is convex: nothing closes, whatever friction would have done
        work.tally[to.SLIPPERY] += 1
        for f in range(faces):
            work.friction[f] = 0.0
        for c in range(count + faces):
            work.impulse[c] = 0.0
        best = search(count, faces, enough * scale, accepted * scale, inverse, work)
    return best


@kernel
def slot(ends, begin, count, c, island):
    """Return where the impulse of a constraint is kept: two normals and a tangent for each pair."""
    f = face_of(count, c, island)
    pair = ends[island.row[begin + island.normal[f]], to.PAIR]
    return 3 * pair + (c - island.normal[f] if c < count else 2)


@kernel
def settle(rows, ends, work, inverse, motion, enough, accepted, pushed, warm):
    """Solve the contact problems of all islands, and change ``motion`` by their impulses.

    Args:
        rows: contact points, pair by pair.
        ends: their bodies and pairs.
        work: ``plant.effects.parcel_contact.bodies.ContactWorkspace``.
        inverse: ``(b, 2)`` one over mass and over moment of inertia; 0, 0 for what can't be moved.
        motion: ``(b, 3)`` along x, along y, turning; changed in place.
        enough: error, over the fastest motion, at which the search ends.
        accepted: the same, above which another attempt is made.
        pushed: ``(3 k,)`` impulses of each pair that has rows: written.
        warm: whether attempts begin with the impulses in ``pushed``.

    Returns:
        The largest error left in an island that counts as not solved, as a motion; 0 if all are.
    """
    worst, island, begin = at.NOTHING, work.impulses, at.ZERO
    for k in range(sort_islands(ends, ends.shape[0], inverse, island)):
        end = island.until[island.island[k]]
        points, faces = end - begin, number_faces(ends, begin, end, island)
        scale = assemble(rows, ends, island.row[begin:end], faces, inverse, motion, island)
        for c in range(points + faces):
            island.impulse[c] = pushed[slot(ends, begin, points, c, island)] if warm and scale > 0.0 else 0.0
        if scale > 0.0:
            error = solve_island(points, faces, scale, enough, accepted, inverse, island)
            apply_impulses(points, faces, island.impulse, inverse, motion, island)
            if error > UNSETTLED * scale:
                worst = max(worst, error)
            island.tally[to.PROBLEMS] += 1
        for c in range(points + faces):
            pushed[slot(ends, begin, points, c, island)] = island.impulse[c]
        begin = end
    return worst
