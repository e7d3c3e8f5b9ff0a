"""Contact problem of one island: constraints, their motions under impulses, and complementarity.

An island is a set of bodies that touch, connected through bodies that move. Its *faces* are its pairs: one or two
points with a common tangent. A face has a constraint along the normal for each point, and a single one across: two
points of a face slide at one speed, so that only the sum of their friction is determined. Constraints are numbered
normals first, in the order of the rows, then tangents, in the order of the faces.

The impulses ``p`` solve ``w = A p + g`` with ``w >= 0, p >= 0, p w = 0`` for normals and Coulomb's law for tangents
(Stewart, SIAM Review 42 (2000), eqs. 2.3 to 2.7, at the level of velocities and impulses). ``A`` is never stored: its
products go through the motions of the bodies, and its entries are those of faces that share a body that moves.
"""

from __future__ import annotations

from typing import Final

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.contact import layout as to

COMPLIANCE: Final = 1e-6
"""How much a held tangent gives, over its yielding: faces that hold each other all round may ask for what can't be."""


@kernel
def root_of(leader, i):
    """Return the body that stands for the island of ``i``; the way there gets shorter."""
    while leader[i] != i:
        leader[i] = leader[leader[i]]
        i = leader[i]
    return i


@kernel
def sort_islands(ends, count, inverse, work):
    """Divide rows into islands, connected through bodies that move.

    Writes ``work.row``, the rows island by island, each in ascending order, and ``work.until``, where the rows of the
    island end, by the island's smallest body.

    Returns:
        How many islands, whose smallest bodies are the first entries of ``work.island``.
    """
    leader, until, islands = work.leader, work.until, at.ZERO
    for i in range(leader.shape[0]):
        leader[i] = i
        until[i] = 0
    for n in range(count):
        i, j = ends[n, 0], ends[n, 1]
        if inverse[i, 0] > 0.0 and inverse[j, 0] > 0.0:
            first, second = root_of(leader, i), root_of(leader, j)
            leader[max(first, second)] = min(first, second)
    for n in range(count):
        here = island_of(ends, n, inverse, leader)
        if until[here] == 0:
            work.island[islands] = here
            islands += 1
        until[here] += 1
    total = at.ZERO
    for k in range(islands):
        here = work.island[k]
        total += until[here]
        until[here] = total - until[here]
    for n in range(count):
        here = island_of(ends, n, inverse, leader)
        work.row[until[here]] = n
        until[here] += 1
    return islands


@kernel
def island_of(ends, n, inverse, leader):
    """Return the island of a row."""
    return root_of(leader, ends[n, 0] if inverse[ends[n, 0], 0] > 0.0 else ends[n, 1])


@kernel
def number_faces(ends, begin, end, work):
    """Write ``work.face`` of rows ``begin`` to ``end`` of ``work.row``, from 0. Returns how many faces."""
    faces = at.ZERO
    for n in range(begin, end):
        if n == begin or ends[work.row[n], to.PAIR] != ends[work.row[n - 1], to.PAIR]:
            work.normal[faces] = n - begin
            faces += 1
        work.face[n - begin] = faces - 1
    work.normal[faces] = end - begin
    return faces


@kernel
def add_direction(arms, row, x, y, share):
    """Add to ``arms`` a unit impulse at a row's point along ``(x, y)`` on the second body, and its opposite."""
    arms[0] -= share * x
    arms[1] -= share * y
    arms[2] -= share * (row[to.AX] * y - row[to.AY] * x)
    arms[3] += share * x
    arms[4] += share * y
    arms[5] += share * (row[to.BX] * y - row[to.BY] * x)


@kernel
def assemble(rows, ends, selected, faces, inverse, motion, work):
    """Write the constraints of the selected rows: ``arms`` to ``yielding`` of the workspace.

    Args:
        rows: as ``plant.kernels.contact.layout`` has them.
        ends: bodies and pair of each row.
        selected: ``(count,)`` rows of the island, face by face.
        faces: number of faces.
        inverse: ``(b, 2)`` one over mass and over moment of inertia.
        motion: ``(b, 3)`` of the bodies, without impulses.
        work: workspace, with ``face`` and ``normal``.

    Returns:
        The fastest motion in the problem, m/s for velocities, m for places.
    """
    count, scale = selected.shape[0], at.NOTHING
    for f in range(faces):
        tangent, first = count + f, work.normal[f]
        share = 1.0 / (work.normal[f + 1] - first)
        for k in range(6):
            work.arms[tangent, k] = 0.0
        for n in range(first, work.normal[f + 1]):
            row = rows[selected[n]]
            for k in range(6):
                work.arms[n, k] = 0.0
            add_direction(work.arms[n], row, row[to.NORMAL_X], row[to.NORMAL_Y], 1.0)
            add_direction(work.arms[tangent], row, -row[to.NORMAL_Y], row[to.NORMAL_X], share)
            work.lacking[n] = -row[to.WANTED]
            scale = max(scale, abs(row[to.WANTED]) + abs(row[to.ASIDE_WANTED]))
        row = rows[selected[first]]
        work.friction[f] = row[to.FRICTION]
        work.held[f] = 1 if row[to.HOLD] != 0.0 else 0
        work.lacking[tangent] = -row[to.ASIDE_WANTED] if work.held[f] != 0 else 0.0
        for k in range(2):
            i = ends[selected[first], k]
            work.bodies[f, k] = i
            work.head[i] = -1
            scale = max(scale, abs(motion[i, 0]) + abs(motion[i, 1]))
    for f in range(faces - 1, -1, -1):
        for k in range(2):
            work.other[2 * f + k] = work.head[work.bodies[f, k]]
            work.head[work.bodies[f, k]] = 2 * f + k
    for c in range(count + faces):
        speed = total = at.NOTHING
        for p in range(2):
            i = work.bodies[face_of(count, c, work), p]
            for k in range(3):
                speed += work.arms[c, 3 * p + k] * motion[i, k]
            total += coupling(work.arms[c], p, work.arms[c], p, inverse[i])
        work.lacking[c] += speed
        work.yielding[c] = total
        scale = max(scale, abs(speed))
    return scale


@kernel
def face_of(count, c, work):
    """Return the face of a constraint."""
    return work.face[c] if c < count else c - count


@kernel
def coupling(arms, p, other, q, inverse):
    """Motion along ``arms`` of a unit impulse along ``other`` through the body at the ends ``p`` and ``q``, 1/kg."""
    a, b = 3 * p, 3 * q
    linear = arms[a] * other[b] + arms[a + 1] * other[b + 1]
    return linear * inverse[0] + arms[a + 2] * other[b + 2] * inverse[1]


@kernel
def push_bodies(count, c, impulse, inverse, motion, work):
    """Change the motions of the two bodies of a constraint by an impulse."""
    f = face_of(count, c, work)
    for p in range(2):
        i = work.bodies[f, p]
        motion[i, 0] += inverse[i, 0] * work.arms[c, 3 * p] * impulse
        motion[i, 1] += inverse[i, 0] * work.arms[c, 3 * p + 1] * impulse
        motion[i, 2] += inverse[i, 1] * work.arms[c, 3 * p + 2] * impulse


@kernel
def motion_along(count, c, work):
    """Return the motion along a constraint, with what impulses have given the bodies in ``work.gained``."""
    f, total = face_of(count, c, work), work.lacking[c]
    for p in range(2):
        i = work.bodies[f, p]
        for k in range(3):
            total += work.arms[c, 3 * p + k] * work.gained[i, k]
    return total


@kernel
def apply_impulses(count, faces, impulse, inverse, motion, work):
    """Change ``motion`` ``(b, 3)`` by impulses ``(count + faces,)``."""
    for c in range(count + faces):
        if impulse[c] != 0.0:
            push_bodies(count, c, impulse[c], inverse, motion, work)


@kernel
def remaining_error(count, faces, impulse, inverse, work):
    """Write ``w = A p + g`` to ``work.motion``; return the largest violation of complementarity, as a motion."""
    worst = at.NOTHING
    for f in range(faces):
        work.push[f] = 0.0
        for p in range(2):
            for k in range(3):
                work.gained[work.bodies[f, p], k] = 0.0
    apply_impulses(count, faces, impulse, inverse, work.gained, work)
    for c in range(count + faces):
        work.motion[c] = motion_along(count, c, work)
    for n in range(count):
        work.push[work.face[n]] += impulse[n]
        worst = max(worst, abs(min(work.motion[n], work.yielding[n] * impulse[n])))
    for f in range(faces):
        t = count + f
        if work.held[f] != 0:
            work.motion[t] += COMPLIANCE * work.yielding[t] * impulse[t]
            worst = max(worst, abs(work.motion[t]))
        elif work.friction[f] > 0.0:
            has, most = impulse[t] * work.yielding[t], work.friction[f] * work.push[f] * work.yielding[t]
            worst = max(worst, abs(has - min(max(has - work.motion[t], -most), most)))
    return worst
