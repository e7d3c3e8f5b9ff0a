"""Impacts: Newton's restitution and Coulomb's friction at all points that touch at an instant, together."""

from __future__ import annotations

from math import sqrt
from typing import Final

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.contact import layout as to
from plant.kernels.contact.impulses import ACCEPTED, SOLVED, leaving, settle
from plant.kernels.contact.manifold import build_rows, move_row
from plant.kernels.contact.resting import part

CLOSING: Final = 1e-10
"""What closes more slowly, m/s, doesn't close."""
IN_TURN: Final = 50
"""Impacts in turn for each point, after which what is left is one impact of all."""
ROUNDING: Final = 1e-13
"""A gain of energy as small, over the energy, is none."""


@kernel
def energy(inverse, motion):
    """Kinetic energy of the bodies that move, J."""
    total = at.NOTHING
    for i in range(inverse.shape[0]):
        if inverse[i, 0] > 0.0:
            u = motion[i]
            total += 0.5 * ((u[0] * u[0] + u[1] * u[1]) / inverse[i, 0] + u[2] * u[2] / inverse[i, 1])
    return total


@kernel
def rebound(closing, restitution, slow):
    """Return the speed at which a point opens that closed at ``closing``, m/s.

    Below ``slow`` nothing bounces. From there to twice that speed the restitution grows to its value, so that a small
    change of speed never makes a jump of the motion.
    """
    return (
        restitution * closing * min(max(closing / slow - 1.0, 0.0), 1.0)
        if slow > 0.0
        else restitution * closing
    )


@kernel
def strike(group, work, begin, end, before, restitution, friction, after):
    """Write the velocities after an impact at some rows, by the rule for every point alone."""
    rows, ends = work.rows, work.ends
    for i in range(before.shape[0]):
        for k in range(3):
            after[i, k] = before[i, k]
    for n in range(begin, end):
        row = rows[n]
        row[to.WANTED] = rebound(
            -leaving(row, before[ends[n, 0]], before[ends[n, 1]]), restitution, group.slow
        )
        row[to.FRICTION] = friction
    error = settle(
        rows[begin:end], ends[begin:end], work, group.inverse, after, SOLVED, ACCEPTED, work.shifted, False
    )
    work.left[to.ERROR] = max(work.left[to.ERROR], error)


@kernel
def bounce(group, begin, end, states, restitution, friction, work):
    """Apply an impact at the rows ``begin`` to ``end`` of ``work``, all at once, to the velocities of bodies.

    Every point that closed faster than twice ``group.slow`` opens at ``restitution`` times its closing speed at least.
    Every other point doesn't close. With friction, or with several points, this rule can add energy. The impact is then
    a mixture with the impact without restitution, such that no energy is added. Both impacts satisfy the contact and
    friction rules, so the mixture does.
    """
    before, after, dead = work.first, work.second, work.third
    for i in range(states.shape[0]):
        for k in range(3):
            before[i, k] = states[i, 3 + k]
    strike(group, work, begin, end, before, restitution, friction, after)
    had, share = energy(group.inverse, before), 1.0
    gained = energy(group.inverse, after) - had
    if gained > ROUNDING * had:
        strike(group, work, begin, end, before, at.NOTHING, friction, dead)
        # energy is convex along the mixture, not above what it was at its beginning, and above that at its end
        lost = min(energy(group.inverse, dead) - had, 0.0)
        for i in range(states.shape[0]):
            for k in range(3):
                after[i, k] -= dead[i, k]
        bend = energy(group.inverse, after)
        slope = gained - lost - bend
        # both impacts are one where nothing bounces: what it gained is what the solution is off by
        if bend > 0.0:
            share = (-slope + sqrt(max(slope * slope - 4.0 * bend * lost, 0.0))) / (2.0 * bend)
        for i in range(states.shape[0]):
            for k in range(3):
                after[i, k] = dead[i, k] + min(max(share, 0.0), 1.0) * after[i, k]
    for i in range(states.shape[0]):
        for k in range(3):
            states[i, 3 + k] = after[i, k]


@kernel
def fastest_pair(count, states, work):
    """Find the pair with the point that closes fastest.

    Returns:
        Its speed, m/s, its first row, and the end of its rows.
    """
    fastest, which, ends = at.NOTHING, at.ZERO, work.ends
    for n in range(count):
        speed = -leaving(work.rows[n], states[ends[n, 0], 3:], states[ends[n, 1], 3:])
        if speed > fastest:
            fastest, which = speed, n
    begin = end = which
    while begin > 0 and ends[begin - 1, to.PAIR] == ends[which, to.PAIR]:
        begin -= 1
    while end < count and ends[end, to.PAIR] == ends[which, to.PAIR]:
        end += 1
    return fastest, begin, end


@kernel
def meet(group, states, work):
    """Resolve overlap in ``states``, then write touching points to ``work`` as rows. Returns how many."""
    rows, ends = work.rows, work.ends
    count, least = build_rows(group, work.marks, to.EVERY, states, to.TOUCH_M, rows, ends), at.NOTHING
    for n in range(count):
        least = min(least, rows[n, to.SPACE])
    if least < 0.0:
        work.left[to.PARTED] = max(work.left[to.PARTED], -least)
        for p in range(work.held.shape[0]):
            work.held[p] = 0
        part(group, states, states, work)
        count = build_rows(group, work.marks, to.EVERY, states, to.TOUCH_M, rows, ends)
    stored = at.ZERO
    for n in range(count):
        if rows[n, to.SPACE] <= to.TOUCH_M:
            move_row(rows, ends, n, stored)
            stored += 1
    return stored


@kernel
def collide(group, count, states, restitution, friction, sequential, work):
    """Apply an impact to the velocities of touching bodies.

    Args:
        group: ``plant.effects.parcel_contact.bodies.Group``.
        count: number of rows in ``work``, as ``meet`` leaves them.
        states: ``(b, 6)``; velocities are changed.
        restitution: in [0, 1].
        friction: Coulomb's coefficient.
        sequential: whether pairs strike one after another, the fastest first, while any closes faster than
            ``group.slow``; otherwise, and for what is left, all strike at once.
        work: ``plant.effects.parcel_contact.bodies.ContactWorkspace``.

    Returns:
        The closing speed of the fastest point, m/s.
    """
    fastest, begin, end = fastest_pair(count, states, work)
    if sequential and fastest > CLOSING:
        speed = fastest
        for _ in range(IN_TURN * count):
            if speed <= max(group.slow, CLOSING):
                break
            bounce(group, begin, end, states, restitution, friction, work)
            speed, begin, end = fastest_pair(count, states, work)
        restitution = at.NOTHING
    if fastest > CLOSING:
        bounce(group, at.ZERO, count, states, restitution, friction, work)
    return fastest


@kernel
def opening(count, states, work):
    """Write to ``work.opens`` how fast each pair's slowest point opens, m/s; less than nothing without a point."""
    rows, ends, opens = work.rows, work.ends, work.opens
    for p in range(opens.shape[0]):
        opens[p] = -to.BEYOND
    for n in range(count):
        p, speed = ends[n, to.PAIR], leaving(rows[n], states[ends[n, 0], 3:], states[ends[n, 1], 3:])
        opens[p] = speed if opens[p] == -to.BEYOND else min(opens[p], speed)
