"""Motion along captured surfaces under laws whose forces have no series: fractions are unknowns beside velocities.

On the two sides of a captured surface the parcel has different supports. Forces are linear in the loads, and mix as the
loads do (Filippov): a wheel that sticks or slips does so under its mean load, and pulls within its mean limit. At an
instant the fractions keep the surfaces' second rates at zero, in a step the rates at its end.
"""

from __future__ import annotations

from math import cos, sin

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.branches import settle_branches
from plant.kernels.common.hooks import implements
from plant.kernels.common.modes import gather, least_share, mix
from plant.kernels.common.modes import grasp as grasp_series
from plant.kernels.common.motion import accelerations, solve, surface_rates, surfaces
from plant.kernels.implicit.dense import accelerate, over_an_instant
from plant.kernels.implicit.extrapolation import extrapolated, near

ROUNDS = 30
NUDGE = 1e-3
"""A fraction is changed by as much, to see how accelerations answer."""
RIGHT = 1e-13
"""A change of a fraction that is none, ..."""
ROUGH = 1e-6
"""... and one where accelerations are those over an instant."""
PAST = 1e-6
"""A step is ended where a fraction has left [0, 1] by as much, ..."""
FAR_PAST = 3e-6
"""... or up to this, ..."""
BETWEEN = 1e-2
"""... and shortened where within it one is out by more than this: a part's fraction lags."""
LOOKS = 64
"""So many times is a step that ends there taken at most."""
CLOSE = 1e-13
"""Two ends of a step this near, s, are one."""


@kernel
def by_series(work):
    """Whether the parcel's captured motion is the exact solver's."""
    return work.law[im.CAPTURES] == im.BY_SERIES


@implements(gather, "law", own=True)
def _gather(work, surface, parcel, m, e, mixes):
    if by_series(work):
        grasp_series(surface, parcel, work.segs[m], m, e, mixes)
        return
    # accelerations are asked for here, as where a step begins
    work.centroid[m, 0], work.centroid[m, 1] = work.segs[m, at.CX], work.segs[m, at.CY]
    work.begin[0], work.begin[1] = parcel.y[0], parcel.y[1]
    if work.law[im.LOCATED] == im.KINKS:
        settle_branches(surface, parcel, work.segs[m], m, e)


@kernel
def second_rates(surface, parcel, work, row, c, s):
    """Accelerations at the present fractions into ``work.adds[row]``, the surfaces' second rates into ``seconds``.

    Returns the status, as ``dense.accelerate`` does.
    """
    add = work.adds[row]
    status = accelerate(surface, parcel, work, work.pace[im.NOW], add)
    for g in range(parcel.ctl[at.N_GROUPS]):
        _, _, work.seconds[row, g] = surface_rates(work.grp[g], parcel.y, c, s, add[0], add[1], add[2])
    return status


@kernel
def mix_instant(surface, parcel, work, c, s):
    """As ``motion.accelerations``, by Newton's method on the fractions."""
    groups, add, second, fraction = parcel.ctl[at.N_GROUPS], work.adds, work.seconds, work.fraction
    law, conditioning = work.law, 1.0
    precise = not over_an_instant(law)
    enough = RIGHT if precise else ROUGH
    for h in range(groups):
        fraction[h] = 0.5
    for _ in range(ROUNDS):
        for h in range(groups):
            fraction[h] += NUDGE
            second_rates(surface, parcel, work, 1 + h, c, s)
            fraction[h] -= NUDGE
        status = second_rates(surface, parcel, work, at.ZERO, c, s)
        if groups == 0:
            break
        if status == at.TIPPED:
            # no loads balance the traction of some mode
            return add[0, 0], add[0, 1], add[0, 2], 0.0
        for h in range(groups):
            for k in range(3):
                work.reply[k, h] = (add[1 + h, k] - add[0, k]) / NUDGE
            for g in range(groups):
                work.matrix[g, h] = (second[1 + h, g] - second[0, g]) / NUDGE
        for g in range(groups):
            work.reply[3, g] = -second[0, g]
        conditioning = solve(work.matrix, groups, work.reply[3], work.change, work.scratch)
        if conditioning == 0.0:
            break
        off = 0.0
        for h in range(groups):
            fraction[h] = near(work, fraction[h] + work.change[h])
            off = max(off, abs(work.change[h]))
        if off <= enough:
            break
    if not precise:
        for h in range(groups):
            if abs(fraction[h] - 0.5) <= 0.5 + ROUGH:
                fraction[h] = max(0.0, min(1.0, fraction[h]))
    return add[0, 0], add[0, 1], add[0, 2], conditioning


@implements(mix, "law", own=True)
def _mix(work, surface, parcel, e, c, s):
    if by_series(work):
        return accelerations(parcel, work, e, c, s)
    return mix_instant(surface, parcel, work, c, s)


@kernel
def accelerate_along(surface, parcel, work, now, acceleration):
    """As ``dense.accelerate``, along captured surfaces if there are any."""
    if parcel.ctl[at.N_GROUPS] == 0:
        return accelerate(surface, parcel, work, now, acceleration)
    work.pace[im.NOW] = now
    surfaces(surface, parcel, work.grp)
    c, s = cos(parcel.y[at.THETA]), sin(parcel.y[at.THETA])
    acceleration[0], acceleration[1], acceleration[2], _ = mix_instant(surface, parcel, work, c, s)
    return at.MOVING


@kernel
def room(surface, parcel, work, now):
    """How far the fraction that is nearest to an end of [0, 1] is within it where the parcel is."""
    accelerate_along(surface, parcel, work, now, work.ended)
    share, _, _ = least_share(parcel, work)
    return share


@kernel
def until_a_side_ends(surface, parcel, work, now, h, begin):
    """End the step of ``h`` just taken where a captured group's fraction leaves [0, 1].

    ``begin`` is ``room`` where the step begins. Returns (status, seconds, attempts).
    """
    status, attempts, last = at.MOVING, at.ZERO, h
    low, high, at_low, at_high = 0.0, h, begin, room(surface, parcel, work, now + h)
    while attempts < LOOKS and high - low > CLOSE:
        if at_high >= -FAR_PAST and (last != high or work.first[im.OUTSIDE] <= BETWEEN):
            break
        t = 0.5 * (low + high)
        if at_high < -FAR_PAST and attempts % 3 != 2:
            t = low + (high - low) * (at_low + PAST) / (at_low - at_high)
        if not low < t < high:
            t = 0.5 * (low + high)
        status, _ = extrapolated(surface, parcel, work, now, t)
        attempts += 1
        if status != at.MOVING:
            return status, t, attempts
        outside, last = work.first[im.OUTSIDE], t
        here = room(surface, parcel, work, now + t)
        if here < -PAST or outside > BETWEEN or at_high >= -FAR_PAST:
            high, at_high = t, here
        else:
            low, at_low = t, here
    if last != high:
        status, _ = extrapolated(surface, parcel, work, now, high)
        attempts += 1
    return status, high, attempts
