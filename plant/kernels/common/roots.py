"""Roots of event polynomials on the unit interval, isolated so that none is missed.

A step's event functions are polynomials, so they can be bounded instead of sampled: an interval whose constant
term outweighs all others holds no root; one whose slope outweighs all curvature holds at most one, told by the
signs at its ends; any other interval is halved. Two crossings inside one step (a corner that clips a cell and
leaves) are therefore found like any other.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel

NONE = 2.0
"""Returned where there is no crossing: past the unit interval."""
NARROWEST = 2.0**-36
"""An interval this small that still can't be decided holds a double root to rounding: a touch, not a crossing."""
ROUNDING = 1e-15
"""Values below this share of the coefficients' sum are rounding; an interval of such values is halved no further, or
a root of high multiplicity would be looked for at every point of its neighbourhood."""


@kernel
def horner(g, order, t):
    """Value of the polynomial ``g[0..order]`` at ``t``."""
    value = g[order]
    for k in range(order - 1, -1, -1):
        value = value * t + g[k]
    return value


@kernel
def restrict(g, order, start, width, p):
    """Coefficients of ``g(start + width t)`` into ``p`` (a Taylor shift, then a scaling)."""
    for k in range(order + 1):
        p[k] = g[k]
    if start != 0.0:
        for i in range(order):
            for k in range(order - 1, i - 1, -1):
                p[k] += start * p[k + 1]
    scale = 1.0
    for k in range(1, order + 1):
        scale *= width
        p[k] *= scale


@kernel
def polish(p, order):
    """The one root of a monotone polynomial in [0, 1], by Newton inside a shrinking bracket."""
    low, high = 0.0, 1.0
    rising = p[0] < 0.0
    t = 0.5
    if p[1] != 0.0:
        t = -p[0] / p[1]
        if not (0.0 < t < 1.0):
            t = 0.5
    for _ in range(80):
        value, slope = p[order], 0.0
        for k in range(order - 1, -1, -1):
            slope = slope * t + value
            value = value * t + p[k]
        if value == 0.0:
            return t
        if (value < 0.0) == rising:
            low = t
        else:
            high = t
        following = t - value / slope if slope != 0.0 else 0.5 * (low + high)
        if not (low < following < high):
            following = 0.5 * (low + high)
        if abs(following - t) <= 1e-16 or following in (low, high):
            return following
        t = following
    return t


@kernel
def first_crossing(g, order, end, p):
    """Earliest ``t`` in ``(0, end]`` where ``g`` changes from not negative to negative, or ``NONE``.

    Args:
        g: coefficients in unit time; a root at 0 must have been divided out (see ``deflate``).
        order: degree of ``g``.
        end: search no further than this (0 < end <= 1).
        p: work space for one polynomial.
    """
    start, width = 0.0, 1.0
    above = g[0] >= 0.0
    floor = 0.0
    for k in range(order + 1):
        floor += ROUNDING * abs(g[k])
    while start < end:
        restrict(g, order, start, width, p)
        rest, curvature = 0.0, 0.0
        for k in range(1, order + 1):
            size = abs(p[k])
            rest += size
            if k > 1:
                curvature += k * size
        last = p[0]
        if abs(p[0]) <= rest:
            monotone = abs(p[1]) > curvature
            if not monotone and width > NARROWEST and abs(p[0]) + rest > floor:
                width *= 0.5
                continue
            for k in range(1, order + 1):
                last += p[k]
            if above and p[0] >= 0.0 > last:
                t = start + width * (polish(p, order) if monotone else 0.5)
                return t if t <= end else NONE
        if above and last < 0.0:
            # the sign changed between the last interval's end and this one's start: equal but for rounding
            return start
        above = last >= 0.0
        start += width
        while width < 1.0 and (start / (2.0 * width)) % 1.0 == 0.0:
            width *= 2.0
    return NONE


@kernel
def deflate(g, order, zero):
    """Divide out a root at t = 0: coefficients below ``zero`` in front are rounding, not motion.

    Shifts ``g`` down in place. Returns the new degree and the sign of ``g`` just after 0 (0 where the whole
    polynomial is rounding).
    """
    drop = 0
    while drop <= order and abs(g[drop]) <= zero:
        drop += 1
    if drop > order:
        return 0, 0
    if drop > 0:
        for k in range(order + 1 - drop):
            g[k] = g[k + drop]
    return order - drop, (1 if g[0] > 0.0 else -1)
