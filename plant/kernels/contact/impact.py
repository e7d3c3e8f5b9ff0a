"""Impacts: Newton's restitution and Coulomb's friction at all points that touch at an instant, together."""

from __future__ import annotations

from math import sqrt
from typing import Final

from plant.kernels.common import layout as at
from plant.kernels.common.jit import kernel
from plant.kernels.contact import layout as to
from plant.kernels.contact.impulses import ACCEPTED, UNSETTLED, leaving, settle
from plant.kernels.contact.manifold import build_rows, move_row
from plant.kernels.contact.resting import part

CLOSING: Final = 1e-10
"""What closes more slowly, m/s, doesn't close."""
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
def strike(group, work, count, before, restitution, friction, after):
    """Velocities after an impact, by the rule for every point alone. Returns whether they were found."""
    rows, ends = work.rows, work.ends
    for i in range(before.shape[0]):
        for k in range(3):
            after[i, k] = before[i, k]
    for n in range(count):
        row = rows[n]
        closing = -leaving(row, before[ends[n, 0]], before[ends[n, 1]])
        row[to.WANTED] = restitution * closing if closing > group.slow else 0.0
        row[to.FRICTION] = friction
    return settle(work, count, group.inverse, after, ACCEPTED) <= UNSETTLED


@kernel
def meet(group, states, work):
    """Resolve overlap in ``states``, then write touching points to ``work`` as rows. Returns (row count; outcome)."""
    rows, ends = work.rows, work.ends
    count, least = build_rows(group, work.marks, to.EVERY, states, to.TOUCH_M, rows, ends), at.NOTHING
    for n in range(count):
        least = min(least, rows[n, to.SPACE])
    if least < 0.0:
        for p in range(work.held.shape[0]):
            work.held[p] = 0
        if not part(group, states, states, work):
            return 0, to.NOT_PARTED
        count = build_rows(group, work.marks, to.EVERY, states, to.TOUCH_M, rows, ends)
    stored = at.ZERO
    for n in range(count):
        if rows[n, to.SPACE] <= to.TOUCH_M:
            move_row(rows, ends, n, stored)
            stored += 1
    return stored, to.DONE


@kernel
def collide(group, count, states, restitution, friction, work):
    """Apply an impact to the velocities of touching bodies.

    Every point that closed faster than ``group.slow`` opens at ``restitution`` times its closing speed at least. Every
    other point doesn't close. With friction, or with several points, this rule can add energy. The impact is then a
    mixture with the impact without restitution, such that no energy is added. Both impacts satisfy the contact and
    friction rules, so the mixture does.

    Args:
        group: ``plant.effects.parcel_contact.bodies.Group``.
        count: number of rows in ``work``, as ``meet`` leaves them.
        states: ``(b, 6)``; velocities are changed.
        restitution: in [0, 1].
        friction: Coulomb's coefficient.
        work: ``plant.effects.parcel_contact.bodies.ContactWorkspace``.

    Returns:
        (outcome; closing speed of the fastest point, m/s).
    """
    rows, ends, before, after, dead = work.rows, work.ends, work.first, work.second, work.third
    for i in range(states.shape[0]):
        for k in range(3):
            before[i, k] = states[i, 3 + k]
    fastest = at.NOTHING
    for n in range(count):
        fastest = max(fastest, -leaving(rows[n], before[ends[n, 0]], before[ends[n, 1]]))
    if fastest <= CLOSING:
        return to.DONE, fastest
    if not strike(group, work, count, before, restitution, friction, after):
        return to.NOT_SETTLED, fastest
    had, share = energy(group.inverse, before), 1.0
    gained = energy(group.inverse, after) - had
    if gained > ROUNDING * had:
        if not strike(group, work, count, before, at.NOTHING, friction, dead):
            return to.NOT_SETTLED, fastest
        # energy is convex along the mixture, not above what it was at its beginning, and above that at its end
        lost = min(energy(group.inverse, dead) - had, 0.0)
        for i in range(states.shape[0]):
            for k in range(3):
                after[i, k] -= dead[i, k]
        bend = energy(group.inverse, after)
        slope = gained - lost - bend
        share = (-slope + sqrt(max(slope * slope - 4.0 * bend * lost, 0.0))) / (2.0 * bend)
        for i in range(states.shape[0]):
            for k in range(3):
                after[i, k] = dead[i, k] + min(max(share, 0.0), 1.0) * after[i, k]
    for i in range(states.shape[0]):
        for k in range(3):
            states[i, 3 + k] = after[i, k]
    return to.DONE, fastest


@kernel
def opening(count, states, work):
    """Write to ``work.opens`` how fast each pair's slowest point opens, m/s; less than nothing without a point."""
    rows, ends, opens = work.rows, work.ends, work.opens
    for p in range(opens.shape[0]):
        opens[p] = -to.BEYOND
    for n in range(count):
        p, speed = ends[n, to.PAIR], leaving(rows[n], states[ends[n, 0], 3:], states[ends[n, 1], 3:])
        opens[p] = speed if opens[p] == -to.BEYOND else min(opens[p], speed)
