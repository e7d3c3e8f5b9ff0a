"""Whether anything is slow enough to be at rest: asked at every tick, so without a pass over it in Python."""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel


@kernel
def any_slow(state, radius, resting, which, limit):
    """Whether some of the parcels ``which`` are slow, or have been at rest so far.

    Args:
        state: ``(m, 6)``.
        radius: ``(m,)`` farthest corner of each from its centre of mass, m.
        resting: ``(m,)`` bool: which have been at rest so far.
        which: ``(b,)`` their numbers.
        limit: m/s, of every corner.
    """
    for n in range(which.shape[0]):
        i = which[n]
        turning = abs(state[i, at.OMEGA]) * radius[i]
        if resting[i] or max(abs(state[i, at.UX]), abs(state[i, at.UY]), turning) < limit:
            return True
    return False
