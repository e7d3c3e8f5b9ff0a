"""Contact problem of one island: constraints, their motions under unit impulses, and complementarity.

An island is a set of bodies that touch, connected through bodies that move. Its *faces* are its pairs: one or two
points with a common tangent. A face has a constraint along the normal for each point, and a single one across: two
points of a face slide at one speed, so that only the sum of their friction is determined. Constraints are numbered
normals first, in the order of the rows, then tangents, in the order of the faces.

The impulses ``p`` solve ``w = A p + g`` with ``w >= 0, p >= 0, p w = 0`` for normals and Coulomb's law for tangents
(Stewart, SIAM Review 42 (2000), eqs. 2.3 to 2.7, at the level of velocities and impulses).
"""

from __future__ import annotations

from plant.kernels.common import layout as at
from plant.kernels.common.jit import kernel
from plant.kernels.contact import layout as to


@kernel
def mark_islands(ends, count, inverse, leader):
    """Write to ``leader`` the smallest body of each body's island; bodies that stand connect nothing."""
    for i in range(leader.shape[0]):
        leader[i] = i
    changed = True
    while changed:
        changed = False
        for n in range(count):
            i, j = ends[n, 0], ends[n, 1]
            if inverse[i, 0] > 0.0 and inverse[j, 0] > 0.0:
                low = min(leader[i], leader[j])
                if leader[i] != low or leader[j] != low:
                    leader[i] = leader[j] = low
                    changed = True


@kernel
def island_of(ends, n, inverse, leader):
    """Return the island of a row."""
    return leader[ends[n, 0]] if inverse[ends[n, 0], 0] > 0.0 else leader[ends[n, 1]]


@kernel
def select_rows(ends, count, inverse, island, work):
    """List the rows of an island and their faces in ``work``. Returns (number of rows; number of faces)."""
    rows = faces = at.ZERO
    for n in range(count):
        if island_of(ends, n, inverse, work.leader) == island:
            if rows == 0 or ends[n, to.PAIR] != ends[work.row[rows - 1], to.PAIR]:
                faces += 1
            work.row[rows] = n
            work.face[rows] = faces - 1
            rows += 1
    return rows, faces


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
def assemble(rows, ends, count, faces, motion, work):
    """Write the constraints of the selected rows: ``arms``, ``bodies``, ``lacking``, ``friction`` and ``held``.

    Returns the fastest motion in the problem, m/s for velocities, m for places.
    """
    scale = at.NOTHING
    for c in range(count + faces):
        work.lacking[c] = 0.0
        for k in range(6):
            work.arms[c, k] = 0.0
    for f in range(faces):
        work.held[f] = 0
    for n in range(count):
        row, tangent = rows[work.row[n]], count + work.face[n]
        alone = (n == 0 or work.face[n - 1] != work.face[n]) and (
            n == count - 1 or work.face[n + 1] != work.face[n]
        )
        add_direction(work.arms[n], row, row[to.NORMAL_X], row[to.NORMAL_Y], 1.0)
        add_direction(work.arms[tangent], row, -row[to.NORMAL_Y], row[to.NORMAL_X], 1.0 if alone else 0.5)
        for k in range(2):
            i = ends[work.row[n], k]
            work.bodies[n, k] = work.bodies[tangent, k] = i
            scale = max(scale, abs(motion[i, 0]) + abs(motion[i, 1]))
        work.friction[work.face[n]] = row[to.FRICTION]
        work.lacking[n] = -row[to.WANTED]
        if row[to.HOLD] != 0.0:
            work.held[work.face[n]] = 1
            work.lacking[tangent] = -row[to.ASIDE_WANTED]
        scale = max(scale, abs(row[to.WANTED]) + abs(row[to.ASIDE_WANTED]))
    for c in range(count + faces):
        i, j, arms = work.bodies[c, 0], work.bodies[c, 1], work.arms[c]
        speed = at.NOTHING
        for k in range(3):
            speed += arms[k] * motion[i, k] + arms[3 + k] * motion[j, k]
        work.lacking[c] += speed
        scale = max(scale, abs(speed))
    return scale


@kernel
def coupling(arms, other, same, inverse):
    """Motion along ``arms`` that a unit impulse along ``other`` makes through a body that both end at, 1/kg."""
    a, b = (0 if same[0] == 0 else 3), (0 if same[1] == 0 else 3)
    linear = arms[a] * other[b] + arms[a + 1] * other[b + 1]
    return linear * inverse[0] + arms[a + 2] * other[b + 2] * inverse[1]


@kernel
def assemble_matrix(size, inverse, work):
    """Write ``A``, the motion along each constraint that a unit impulse along each makes, ``(size, size)``, 1/kg."""
    for c in range(size):
        for d in range(c + 1):
            total = at.NOTHING
            for p in range(2):
                for q in range(2):
                    if work.bodies[c, p] == work.bodies[d, q]:
                        body = work.bodies[c, p]
                        total += coupling(work.arms[c], work.arms[d], (p, q), inverse[body])
            work.matrix[c, d] = work.matrix[d, c] = total


@kernel
def apply_impulses(size, inverse, motion, work):
    """Change ``motion`` by the impulses found."""
    for c in range(size):
        for p in range(2):
            i, push = work.bodies[c, p], work.impulse[c]
            motion[i, 0] += inverse[i, 0] * work.arms[c, 3 * p] * push
            motion[i, 1] += inverse[i, 0] * work.arms[c, 3 * p + 1] * push
            motion[i, 2] += inverse[i, 1] * work.arms[c, 3 * p + 2] * push


@kernel
def remaining_error(count, faces, impulse, work):
    """Write ``w = A p + g`` to ``work.motion``; return the largest violation of complementarity, as a motion."""
    worst = at.NOTHING
    for c in range(count + faces):
        total = work.lacking[c]
        for d in range(count + faces):
            total += work.matrix[c, d] * impulse[d]
        work.motion[c] = total
    for f in range(faces):
        work.push[f] = 0.0
    for n in range(count):
        work.push[work.face[n]] += impulse[n]
        worst = max(worst, abs(min(work.motion[n], work.matrix[n, n] * impulse[n])))
    for f in range(faces):
        t = count + f
        if work.held[f] != 0:
            worst = max(worst, abs(work.motion[t]))
        elif work.friction[f] > 0.0:
            has, most = impulse[t] * work.matrix[t, t], work.friction[f] * work.push[f] * work.matrix[t, t]
            worst = max(worst, abs(has - min(max(has - work.motion[t], -most), most)))
    return worst
