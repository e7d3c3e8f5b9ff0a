"""Lemke's pivoting method for the contact problem of one island.

The problem with a face's friction split in two senses and a bound each is a linear complementarity problem whose matrix
is copositive, for which the method ends at a solution where one exists (Stewart and Trinkle, Int. J. Numer. Methods
Eng. 39 (1996); Anitescu and Potra, Nonlinear Dyn. 14 (1997)). The matrix is dense, so the method is for what Newton
steps don't solve. Rows that tie could lead in circles, so the path is that of constants moved a little, differently in
each row. The constants as they are go along, and give the solution at the end of the path.
"""

from __future__ import annotations

from math import sqrt
from typing import Final

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.contact.problem import COMPLIANCE, coupling, face_of

GOLDEN: Final = 0.6180339887498949
SMALLEST: Final = 1e-11
"""A pivot below this, where entries are about 1, is rounding."""
PIVOTS: Final = 20
"""Pivots for each row after which it ends; about two are usual."""


@kernel
def entry_of(count, c, d, inverse, work):
    """Motion along a constraint of a unit impulse along another, 1/kg."""
    f, g, total = face_of(count, c, work), face_of(count, d, work), at.NOTHING
    for p in range(2):
        for q in range(2):
            i = work.bodies[f, p]
            if i == work.bodies[g, q] and inverse[i, 0] > 0.0:
                total += coupling(work.arms[c], p, work.arms[d], q, inverse[i])
    return total


@kernel
def count_rows(count, faces, work):
    """How many rows the table of an island has: a normal has one, a tangent two, and its bound one more."""
    size = count
    for f in range(faces):
        if work.held[f] != 0:
            size += 2
        elif work.friction[f] > 0.0:
            size += 3
    return size


@kernel
def number_rows(count, faces, work):
    """Write ``work.line``: constraint and sense of each row.

    Rows are normals, then tangents in both senses, then the bounds of friction, whose constraint is the tangent and
    whose sense is 0.
    """
    size = at.ZERO
    for n in range(count):
        work.line[size, 0], work.line[size, 1] = n, 1
        size += 1
    for sense in (1, -1, 0):
        for f in range(faces):
            bounded = work.held[f] == 0 and work.friction[f] > 0.0
            if bounded or (work.held[f] != 0 and sense != 0):
                work.line[size, 0], work.line[size, 1] = count + f, sense
                size += 1


@kernel
def fill_table(count, size, table, moved, inverse, work):
    """Write the first dictionary: each row's motion from the impulses, in units in which every yielding is 1."""
    largest = at.NOTHING
    for a in range(size):
        c, sense = work.line[a, 0], work.line[a, 1]
        for b in range(size):
            d, other = work.line[b, 0], work.line[b, 1]
            value = at.NOTHING
            if sense != 0 and other != 0:
                value = sense * other * entry_of(count, c, d, inverse, work)
                value /= sqrt(work.yielding[c] * work.yielding[d])
                if c == d and c >= count and work.held[c - count] != 0:
                    value += sense * other * COMPLIANCE
            elif sense != 0 and c == d:
                value = 1.0
            elif other != 0 and d == c:
                value = -1.0
            elif sense == 0 and other != 0 and d < count and work.face[d] == c - count:
                value = work.friction[c - count] * sqrt(work.yielding[c] / work.yielding[d])
            table[a, b] = value
        table[a, size] = table[a, size + 2] = sense * work.lacking[c] / sqrt(work.yielding[c])
        table[a, size + 1] = 1.0
        largest = max(largest, abs(table[a, size]))
        work.basis[a] = a
        work.outside[a] = size + a
    work.outside[size] = 2 * size
    part = 0.5
    for a in range(size):
        part = (part + GOLDEN) % 1.0
        table[a, size] += moved * largest * (0.5 + part)


@kernel
def exchange(size, table, r, s):
    """Exchange the basic variable of row ``r`` with the other of column ``s``."""
    value = table[r, s]
    for b in range(size + 3):
        if b != s:
            table[r, b] /= -value
    table[r, s] = 1.0 / value
    for a in range(size):
        factor = table[a, s]
        if a != r and factor != 0.0:
            for b in range(size + 3):
                if b != s:
                    table[a, b] += factor * table[r, b]
            table[a, s] = factor * table[r, s]


@kernel
def leaving_row(size, table, s):
    """Return the row whose variable first falls to 0 as that of column ``s`` grows; -1 where none does."""
    best, least, most = at.NO_CELL, 1e300, at.NOTHING
    for a in range(size):
        if table[a, s] < -SMALLEST:
            share = table[a, size] / -table[a, s]
            if share < least or (share == least and -table[a, s] > most):
                best, least, most = a, share, -table[a, s]
    return best


@kernel
def pivot(count, faces, impulse, table, moved, inverse, work):
    """Find impulses by Lemke's method. Returns whether it came to an end.

    Args:
        count: number of normals.
        faces: number of faces.
        impulse: ``(count + faces,)``: written.
        table: ``(rows, rows + 3)`` scratch; the method is not tried where there are more rows.
        moved: how much constants are moved, over the largest.
        inverse: ``(b, 2)`` one over mass and over moment of inertia.
        work: workspace with an assembled island.
    """
    size = count_rows(count, faces, work)
    if size > table.shape[0]:
        return False
    number_rows(count, faces, work)
    fill_table(count, size, table, moved, inverse, work)
    # columns: variables, then the moved constant, the artificial variable, the constant
    r, artificial = at.ZERO, 2 * size
    for a in range(size):
        if table[a, size] < table[r, size]:
            r = a
    if table[r, size] < 0.0:
        s = size + 1
        for _ in range(PIVOTS * size):
            exchange(size, table, r, s)
            entered = work.outside[s - 1 if s > size else s]
            left = work.basis[r]
            work.basis[r], work.outside[s - 1 if s > size else s] = entered, left
            if left == artificial:
                break
            wanted = left + size if left < size else left - size
            for b in range(size + 1):
                if work.outside[b] == wanted:
                    s = b if b < size else size + 1
            r = leaving_row(size, table, s)
            if r < 0:
                return False
            for a in range(size):
                # the artificial variable leaves as soon as it can
                can = work.basis[a] == artificial and table[a, s] < -SMALLEST
                if can and table[a, size] / -table[a, s] <= table[r, size] / -table[r, s]:
                    r = a
        for a in range(size):
            if work.basis[a] == artificial:
                return False
    for c in range(count + faces):
        impulse[c] = 0.0
    for a in range(size):
        variable = work.basis[a] - size
        if 0 <= variable < size:
            c, sense = work.line[variable, 0], work.line[variable, 1]
            impulse[c] += sense * max(table[a, size + 2], 0.0) / sqrt(work.yielding[c])
    return True
