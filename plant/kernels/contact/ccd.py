"""Continuous collision detection between sampled states of two bodies."""

from __future__ import annotations

from math import hypot
from typing import Final

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.contact import layout as to
from plant.kernels.contact.polygons import stays_clear

SEEN: Final = 2.0
"""Accelerations are taken to be at least this many times those seen between two instants."""


@kernel
def corner_pull(pull, wheels, before, after, span):
    """How fast any corner of a body can gain speed between two instants, m/s².

    Traction can't do more than its law allows at the fastest slip: that between the fastest wheel and the fastest
    corner, which gains speed itself meanwhile. What is seen to have happened counts where it is more than that.
    """
    speed = max(
        hypot(before[at.UX], before[at.UY]) + pull[to.RADIUS] * abs(before[at.OMEGA]),
        hypot(after[at.UX], after[at.UY]) + pull[to.RADIUS] * abs(after[at.OMEGA]),
    )
    growth = 1.0 - min(0.5 * (pull[to.PER_SLIP] + pull[to.UNLIMITED]) * span, 0.5)
    bound = min(pull[to.PER_SLIP] * (speed + wheels) / growth, pull[to.LIMIT]) + pull[to.PUSH]
    bound += pull[to.UNLIMITED] * (speed + wheels) / growth
    gained = hypot(after[at.UX] - before[at.UX], after[at.UY] - before[at.UY])
    gained += pull[to.RADIUS] * abs(after[at.OMEGA] - before[at.OMEGA])
    omega = max(abs(before[at.OMEGA]), abs(after[at.OMEGA]))
    return max(bound, SEEN * gained / span) + pull[to.RADIUS] * omega * omega


@kernel
def first_uncertain(shapes, pairs, pull, wheels, times, states, start):
    """The earliest interval in which a pair can have met.

    Args:
        shapes: ``plant.effects.parcel_contact.bodies.Shapes`` of the bodies.
        pairs: ``(k, 2)`` bodies, apart at the start.
        pull: ``(bodies, PULL_SIZE)``.
        wheels: m/s, the fastest wheel.
        times: ``(T,)`` ascending instants, s.
        states: ``(T, bodies, 6)``.
        start: the first instant to look at.

    Returns:
        (the interval's first instant, or the last of all; the pair, or -1).
    """
    for t in range(start, times.shape[0] - 1):
        span = times[t + 1] - times[t]
        for p in range(pairs.shape[0]):
            i, j = pairs[p]
            both = corner_pull(pull[i], wheels, states[t, i], states[t + 1, i], span)
            both += corner_pull(pull[j], wheels, states[t, j], states[t + 1, j], span)
            if not stays_clear(
                shapes, i, j, states[t, i], states[t + 1, i], states[t, j], states[t + 1, j], span, both
            ):
                return t, p
    return times.shape[0] - 1, at.NO_CELL
