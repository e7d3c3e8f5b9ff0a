"""Directions of wheels for traction along the wheels' own motion (eq. 24), and reversals by motors."""

from __future__ import annotations

from math import log as ln

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at

TURNED = 1e-13
"""A wheel turns round now if the parts of its speed cancel to this share: rounding of the decay factor, and of time."""


@kernel
def direction(steady, decay, e):
    """Which way a wheel of speed ``steady + e decay`` runs from now on: 1, -1 or, for one that stands, 0.

    ``e`` falls, and tends to zero: a wheel that turns round now goes on with its steady part, one that comes to a
    stop never quite does.
    """
    speed = steady + e * decay
    if abs(speed) <= TURNED * (abs(steady) + e * abs(decay)):
        speed = steady if steady != 0.0 else decay
    if speed > 0.0:
        return 1.0
    return -1.0 if speed < 0.0 else 0.0


@kernel
def next_turn(surface, parcel, e):
    """Seconds until the next wheel under the parcel turns round, ``e`` being the motors' decay factor now."""
    soonest = 1e300
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = parcel.mem[i, at.CELL]
        for axis in range(2):
            steady, decay = surface.steady[cell, axis], e * surface.decay[cell, axis]
            way = direction(steady, decay, 1.0)
            if way != 0.0 and steady != 0.0 and (way > 0.0) != (steady > 0.0):
                soonest = min(soonest, ln(abs(decay) / abs(steady)) / parcel.par[at.RATE])
    return soonest
