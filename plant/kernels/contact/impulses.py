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

SWEEPS: Final = 20_000
PATIENCE: Final = 2_500
"""Sweeps after which every point goes half as far at a time: strong friction at several points can go in circles."""
SOLVED: Final = 1e-13
"""Change of motion in a sweep, over the fastest motion, below which a problem is solved, ..."""
ACCEPTED: Final = 1e-9
"""... and above which it is not, after all sweeps."""


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
def give(row, x, y, inverse_u, inverse_v, u, v, amount):
    """Apply an impulse along ``(x, y)`` to the second body, and its opposite to the first."""
    u[0] -= amount * x * inverse_u[0]
    u[1] -= amount * y * inverse_u[0]
    u[2] -= amount * (row[to.AX] * y - row[to.AY] * x) * inverse_u[1]
    v[0] += amount * x * inverse_v[0]
    v[1] += amount * y * inverse_v[0]
    v[2] += amount * (row[to.BX] * y - row[to.BY] * x) * inverse_v[1]


@kernel
def yielding(row, x, y, inverse_u, inverse_v):
    """How much motion along ``(x, y)`` a unit impulse makes, 1/kg."""
    a, b = row[to.AX] * y - row[to.AY] * x, row[to.BX] * y - row[to.BY] * x
    return inverse_u[0] + inverse_v[0] + a * a * inverse_u[1] + b * b * inverse_v[1]


@kernel
def slides(sense, ease, mixed, lacking, across, friction):
    """Impulse along the normal of a point that slides, friction drawing in the sense of ``sense`` (1 or -1).

    Negative where it wouldn't: it must push, and what is still lacking across must be more of what friction does.
    """
    stiff = ease + sense * friction * mixed[0]
    if stiff <= 0.0:
        return -1.0
    push = lacking / stiff
    return push if sense * (across - mixed[0] * push - mixed[1] * sense * friction * push) >= 0.0 else -1.0


@kernel
def answer(ease, mixed, lacking, across, friction, held):
    """Impulses along the normal and across that a point needs by itself, exactly: it parts, sticks or slides.

    Args:
        ease: motion along the normal that a unit impulse along it makes.
        mixed: (motion across of a unit impulse along the normal, and of one across).
        lacking: motion that is wanted along the normal and wouldn't be there without impulses.
        across: the same across.
        friction: Coulomb's coefficient.
        held: not 0: what is wanted across is given whatever it takes.
    """
    both, side = mixed
    if held != 0.0:
        push = max(0.0, (lacking - both * across / side) / (ease - both * both / side))
        return push, (across - both * push) / side
    if lacking <= 0.0:
        return 0.0, 0.0
    if friction == 0.0:
        return lacking / ease, 0.0
    whole = ease * side - both * both
    push, pull = (side * lacking - both * across) / whole, (ease * across - both * lacking) / whole
    if push >= 0.0 and abs(pull) <= friction * push:
        return push, pull
    sense = 1.0 if pull > 0.0 else -1.0
    for one in (sense, -sense):
        push = slides(one, ease, mixed, lacking, across, friction)
        if push >= 0.0:
            return push, one * friction * push
    return lacking / ease, 0.0


@kernel
def relax(row, inverse_u, inverse_v, u, v, share):
    """Solve one point with all others as they are, and go ``share`` of the way. Returns the change of its motion."""
    x, y = row[to.NORMAL_X], row[to.NORMAL_Y]
    ease, side = yielding(row, x, y, inverse_u, inverse_v), yielding(row, -y, x, inverse_u, inverse_v)
    a, b = row[to.AX] * y - row[to.AY] * x, row[to.BX] * y - row[to.BY] * x
    both = (
        a * (row[to.AX] * x + row[to.AY] * y) * inverse_u[1]
        + b * (row[to.BX] * x + row[to.BY] * y) * inverse_v[1]
    )
    pushed, pulled = row[to.PUSH_N], row[to.PUSH_T]
    lacking = row[to.WANTED] - along(row, x, y, u, v) + ease * pushed + both * pulled
    across = row[to.ASIDE_WANTED] - along(row, -y, x, u, v) + both * pushed + side * pulled
    push, pull = answer(ease, (both, side), lacking, across, row[to.FRICTION], row[to.HOLD])
    push, pull = share * (push - pushed), share * (pull - pulled)
    if push != 0.0:
        row[to.PUSH_N] += push
        give(row, x, y, inverse_u, inverse_v, u, v, push)
    if pull != 0.0:
        row[to.PUSH_T] += pull
        give(row, -y, x, inverse_u, inverse_v, u, v, pull)
    return max(abs(push) * ease, abs(pull) * side) / share


@kernel
def settle(rows, ends, count, inverse, motion):
    """Solve all points together: projected Gauss-Seidel, in the order of the rows, until nothing changes any more.

    Args:
        rows: ``(., ROW_SIZE)``; ``PUSH_N`` and ``PUSH_T`` are where it begins, and the solution.
        ends: ``(., 3)``.
        count: how many rows.
        inverse: ``(b, 2)`` one over mass and over moment of inertia; 0, 0 for what can't be moved.
        motion: ``(b, 3)`` along x, along y, turning; changed in place.

    Returns:
        Whether it was solved.
    """
    scale = worst = at.NOTHING
    for n in range(count):
        u, v = motion[ends[n, 0]], motion[ends[n, 1]]
        scale = max(scale, abs(leaving(rows[n], u, v)) + abs(sliding(rows[n], u, v)))
        scale = max(scale, abs(u[0]) + abs(u[1]) + abs(v[0]) + abs(v[1]))
        scale = max(scale, abs(rows[n, to.WANTED]) + abs(rows[n, to.ASIDE_WANTED]))
    share = 1.0
    for sweep in range(SWEEPS):
        worst = 0.0
        if sweep > 0 and sweep % PATIENCE == 0:
            share *= 0.5
        for n in range(count):
            i, j = ends[n, 0], ends[n, 1]
            worst = max(worst, relax(rows[n], inverse[i], inverse[j], motion[i], motion[j], share))
        if worst <= SOLVED * scale:
            break
    return worst <= ACCEPTED * scale
