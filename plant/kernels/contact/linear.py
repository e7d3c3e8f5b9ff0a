"""Linear systems of a contact problem's modes: banded, after the faces have been ordered along the island."""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.contact.problem import coupling, face_of


@kernel
def spread(first, inverse, work):
    """List in ``work.order`` the faces that bodies which move connect to a face, nearest first. Returns how many."""
    size, taken = at.ONE, at.ZERO
    work.order[0], work.seen[first] = first, 1
    while taken < size:
        f = work.order[taken]
        taken += 1
        for p in range(2):
            i = work.bodies[f, p]
            if inverse[i, 0] > 0.0:
                entry = work.head[i]
                while entry >= 0:
                    if work.seen[entry // 2] == 0:
                        work.seen[entry // 2] = 1
                        work.order[size] = entry // 2
                        size += 1
                    entry = work.other[entry]
    return size


@kernel
def order_faces(faces, inverse, work):
    """Order the faces of an island from one of its ends, so that coupled faces are near each other in ``work.order``.

    The order is that of Cuthill and McKee (Proc. 24th ACM Nat. Conf. (1969)), from the face that is farthest from the
    first one.
    """
    first = at.ZERO
    for _ in range(2):
        for f in range(faces):
            work.seen[f] = 0
        first = work.order[spread(first, inverse, work) - 1]


@kernel
def widen(f, half, inverse, work):
    """Return the half bandwidth that the couplings of a face need, not less than ``half``."""
    for p in range(2):
        i = work.bodies[f, p]
        if inverse[i, 0] > 0.0:
            entry = work.head[i]
            while entry >= 0:
                g = entry // 2
                if work.least[g] <= work.most[g]:
                    half = max(half, work.most[f] - work.least[g], work.most[g] - work.least[f])
                entry = work.other[entry]
    return half


@kernel
def select_unknowns(count, faces, selected, inverse, work):
    """Number the constraints whose impulses are unknown, in the order of the faces.

    Args:
        count: number of normals.
        faces: number of faces.
        selected: ``(count + faces,)`` whether a constraint's impulse is unknown.
        inverse: ``(b, 2)`` one over mass and over moment of inertia.
        work: workspace; ``unknowns``, ``place``, ``least`` and ``most`` are written.

    Returns:
        (number of unknowns; half bandwidth of their system).
    """
    size = half = at.ZERO
    for k in range(faces):
        f = work.order[k]
        work.least[f] = size
        for n in range(work.normal[f], work.normal[f + 1] + 1):
            c = n if n < work.normal[f + 1] else count + f
            work.place[c] = -1
            if selected[c] != 0:
                work.unknowns[size] = c
                work.place[c] = size
                size += 1
        work.most[f] = size - 1
    for f in range(faces):
        if work.least[f] <= work.most[f]:
            half = widen(f, half, inverse, work)
    return size, half


@kernel
def add_entries(count, a, width, half, slope, inverse, work):
    """Add the row of the unknown ``a``: motions along it that unit impulses of other unknowns make.

    ``slope`` ``(f,)`` is what an impulse along a normal gives across, where the face slides.
    """
    c = work.unknowns[a]
    f = face_of(count, c, work)
    for p in range(2):
        i = work.bodies[f, p]
        if inverse[i, 0] == 0.0:
            continue
        entry = work.head[i]
        while entry >= 0:
            g, q = entry // 2, entry % 2
            tangent = count + g
            across = coupling(work.arms[c], p, work.arms[tangent], q, inverse[i])
            for n in range(work.normal[g], work.normal[g + 1]):
                if work.place[n] >= 0:
                    value = coupling(work.arms[c], p, work.arms[n], q, inverse[i]) + slope[g] * across
                    work.system[a * width + work.place[n] - a + half] += value
            if work.place[tangent] >= 0:
                work.system[a * width + work.place[tangent] - a + half] += across
            entry = work.other[entry]


@kernel
def factorise(size, half, work):
    """Factorise the banded system in place: Gaussian elimination with partial pivoting inside the band.

    Entry ``(a, b)`` is at ``a width + b - a + half`` of ``work.system``, with ``width = 3 half + 1``, as exchanged rows
    need twice the upper band (Golub and Van Loan, Matrix Computations, 4.3.5). Multipliers stay in the lower band.

    Returns:
        Whether the system is regular.
    """
    # rows as slices from 0 on: other indices would be tested for being negative, at six times the cost
    system, width = work.system, 3 * half + 1
    for c in range(size):
        bottom, p = min(c + half, size - 1), c
        for r in range(c + 1, bottom + 1):
            if abs(system[r * width + c - r + half]) > abs(system[p * width + c - p + half]):
                p = r
        length, first = min(c + 2 * half, size - 1) - c + 1, c * width + half
        work.pivot[c], upper = p, system[first : first + length]
        if p != c:
            other = p * width + c - p + half
            exchanged = system[other : other + length]
            for k in range(length):
                upper[k], exchanged[k] = exchanged[k], upper[k]
        if upper[0] == 0.0:
            return False
        while length > 1 and upper[length - 1] == 0.0:
            length -= 1
        rest = upper[1:length]
        for r in range(c + 1, bottom + 1):
            below = r * width + c - r + half
            if system[below] != 0.0:
                factor = system[below] / upper[0]
                system[below] = factor
                lower = system[below + 1 : below + length]
                for k in range(length - 1):
                    lower[k] -= factor * rest[k]
    return True


@kernel
def substitute(size, half, work):
    """Solve the factorised system for ``work.solution``, in place."""
    system, solution, width = work.system, work.solution, 3 * half + 1
    for c in range(size):
        p = work.pivot[c]
        solution[c], solution[p] = solution[p], solution[c]
        for r in range(c + 1, min(c + half, size - 1) + 1):
            solution[r] -= system[r * width + c - r + half] * solution[c]
    for n in range(size):
        c = size - 1 - n
        total = solution[c]
        length, first = min(c + 2 * half, size - 1) - c, c * width + half
        upper, later = system[first + 1 : first + 1 + length], solution[c + 1 : c + 1 + length]
        for k in range(length):
            total -= upper[k] * later[k]
        solution[c] = total / system[first]
