"""Resting contact: pairs that stay in contact through a step, and the corrections of velocities and places."""

from __future__ import annotations

from math import cos, hypot, sin
from typing import Final

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.contact import layout as to
from plant.kernels.contact.impulses import ACCEPTED, SOLVED, leaving, settle, sliding
from plant.kernels.contact.manifold import build_rows, move_row
from plant.kernels.contact.momentum import keep_angular_momentum

KEEP_M: Final = 0.5 * to.TOUCH_M
"""Space left between bodies that press on each other: they never overlap, not even by rounding."""
PARTED_M: Final = 1e-3 * KEEP_M
"""What is left of overlap or slip when places are right."""
ROUNDS: Final = 20
"""Corrections of places, each linear, until they are right: two or three do mostly."""
SHIFTED: Final = 1e-8
"""Error of shifts, over the largest, at which the search ends."""
PLACED: Final = 1e-3
"""Error of shifts, over the largest, above which another attempt is made; further rounds correct what is left."""
HELD_ROUNDS: Final = 3
"""Rounds in which slip counts: parcels that hold each other all round may ask for what can't be."""
STANDS_M_S: Final = 1e-9
"""What slides more slowly, and is held by friction, stands."""
WHOLE: Final = 1.0
"""Shift of places, times mass, per impulse of their problem."""


@kernel
def together(group, states, work):
    """Mark the pairs that stay together: near at a point that neither closes nor opens.

    Returns when a second corner of one of them strikes, in seconds from now.
    """
    rows, ends, marks = work.rows, work.ends, work.marks
    count = build_rows(group, marks, to.EVERY, states, to.NEAR_M, rows, ends)
    for p in range(marks.shape[0]):
        marks[p] = 0
    for n in range(count):
        speed = leaving(rows[n], states[ends[n, 0], 3:], states[ends[n, 1], 3:])
        if rows[n, to.SPACE] <= to.NEAR_M and abs(speed) <= group.slow:
            marks[ends[n, to.PAIR]] = to.TOGETHER
    soonest = to.BEYOND
    count = build_rows(group, marks, to.TOGETHER, states, to.BEYOND, rows, ends)
    for n in range(count):
        speed = leaving(rows[n], states[ends[n, 0], 3:], states[ends[n, 1], 3:])
        if rows[n, to.SPACE] > to.TOUCH_M and -speed > group.slow:
            soonest = min(soonest, rows[n, to.SPACE] / -speed)
    return soonest


@kernel
def grown(before, after, radius):
    """Speed that a body's corners have gained in a step, m/s."""
    linear = hypot(after[at.UX] - before[at.UX], after[at.UY] - before[at.UY])
    return linear + radius * abs(after[at.OMEGA] - before[at.OMEGA])


@kernel
def pressed(group, before, states, step, friction, work):
    """Rows of the points that press at the end of a step, of the pairs that stay together. Returns how many.

    What closes faster than pressing can have made it is an impact to come, and what doesn't reach is left alone.
    """
    rows, ends = work.rows, work.ends
    count, pressing = build_rows(group, work.marks, to.TOGETHER, states, to.BEYOND, rows, ends), at.ZERO
    for n in range(count):
        i, j, row = ends[n, 0], ends[n, 1], rows[n]
        closing = -leaving(row, states[i, 3:], states[j, 3:])
        most = group.slow + grown(before[i], states[i], group.pull[i, to.RADIUS])
        most += grown(before[j], states[j], group.pull[j, to.RADIUS])
        if closing <= most and closing * step >= row[to.SPACE] - to.NEAR_M:
            row[to.WANTED] = 0.0 if row[to.SPACE] <= to.NEAR_M else -row[to.SPACE] / step
            row[to.FRICTION] = friction
            move_row(rows, ends, n, pressing)
            pressing += 1
    return pressing


@kernel
def hold(group, before, states, step, friction, work):
    """Correct velocities and places after a free step of pairs that stay together.

    What pushed acts on places as a force even over the step would have. What friction held has not slid. Linear and
    angular momentum of bodies that touch no standing body stay.

    Args:
        group: ``plant.effects.parcel_contact.bodies.Group``.
        before: ``(b, 6)`` at the start of the step.
        states: at its end, moved freely; changed in place.
        step: s.
        friction: Coulomb's coefficient.
        work: ``plant.effects.parcel_contact.bodies.ContactWorkspace``, with the marks of ``together``.
    """
    rows, ends, held, motion = work.rows, work.ends, work.held, work.first
    count = pressed(group, before, states, step, friction, work)
    for i in range(states.shape[0]):
        for k in range(3):
            motion[i, k] = states[i, 3 + k]
    error = settle(
        rows[:count], ends[:count], work, group.inverse, motion, SOLVED, ACCEPTED, work.pushed, True
    )
    work.left[to.ERROR] = max(work.left[to.ERROR], error)
    for i in range(states.shape[0]):
        for k in range(3):
            states[i, k] += 0.5 * step * (motion[i, k] - states[i, 3 + k])
            states[i, 3 + k] = motion[i, k]
    keep_angular_momentum(count, 0.5 * step, work.pushed, states, group.inverse, work)
    for p in range(held.shape[0]):
        held[p] = 0
    for n in range(count):
        p, row = ends[n, to.PAIR], rows[n]
        # two points share what friction does in any way: that both stand tells, not what each of them pulls
        slid = abs(sliding(row, before[ends[n, 0], 3:], before[ends[n, 1], 3:]))
        slid = max(slid, abs(sliding(row, motion[ends[n, 0]], motion[ends[n, 1]])))
        if friction == 0.0 or slid > STANDS_M_S:
            held[p] = to.SLIPPING
        elif held[p] != to.SLIPPING:
            held[p] = to.HELD
    part(group, before, states, work)


@kernel
def was(before, now, x, y, k):
    """One coordinate, at the start of a step, of a body's matter that is at an arm ``(x, y)`` from its centre now."""
    turn = before[2] - now[2]
    c, s = cos(turn), sin(turn)
    return before[k] - now[k] + (c * x - s * y - x if k == 0 else s * x + c * y - y)


@kernel
def slipped(row, before_i, now_i, before_j, now_j):
    """How far the second body's matter at a point has slid along the first's since ``before``, m."""
    dx = was(before_i, now_i, row[to.AX], row[to.AY], at.ZERO)
    dx -= was(before_j, now_j, row[to.BX], row[to.BY], at.ZERO)
    dy = was(before_i, now_i, row[to.AX], row[to.AY], at.ONE)
    dy -= was(before_j, now_j, row[to.BX], row[to.BY], at.ONE)
    return -row[to.NORMAL_Y] * dx + row[to.NORMAL_X] * dy


@kernel
def part(group, before, states, work):
    """Take overlap out of places, and slip since ``before`` out of the pairs held; changes ``states``.

    Shifts are the least in the metric of the masses: the common centre of mass of what moves stays. Velocities change
    as far as the angular momentum requires. Overlap that is left is noted in ``work.left``.
    """
    rows, ends, shift = work.rows, work.ends, work.second
    least = at.NOTHING
    for turn in range(ROUNDS):
        count = build_rows(group, work.marks, to.EVERY, states, to.NEAR_M, rows, ends)
        worst, least = 0.0, 0.0
        for n in range(count):
            i, j, row = ends[n, 0], ends[n, 1], rows[n]
            row[to.WANTED] = KEEP_M - row[to.SPACE]
            least = min(least, row[to.SPACE])
            worst = max(worst, row[to.WANTED])
            # one point of a pair is enough to hold it: two would ask the same twice, and differ by rounding
            if work.held[ends[n, to.PAIR]] == to.HELD and (
                n == 0 or ends[n - 1, to.PAIR] != ends[n, to.PAIR]
            ):
                row[to.HOLD] = 1.0
                row[to.ASIDE_WANTED] = -slipped(row, before[i], states[i], before[j], states[j])
                if turn < HELD_ROUNDS:
                    worst = max(worst, abs(row[to.ASIDE_WANTED]))
        if worst <= PARTED_M:
            return
        for i in range(states.shape[0]):
            for k in range(3):
                shift[i, k] = 0.0
        settle(rows[:count], ends[:count], work, group.inverse, shift, SHIFTED, PLACED, work.shifted, False)
        for i in range(states.shape[0]):
            for k in range(3):
                states[i, k] += shift[i, k]
        keep_angular_momentum(count, WHOLE, work.shifted, states, group.inverse, work)
    work.left[to.OVERLAP] = max(work.left[to.OVERLAP], -least)
