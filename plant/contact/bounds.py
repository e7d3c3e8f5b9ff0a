"""How fast traction can make a parcel's corners gain speed: what a search without misses rests on."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from plant.friction.law import Traction
from plant.kernels import contact_layout as to
from plant.wheels import WheelMotion

Floats = NDArray[np.float64]

BOTH_AXES = math.sqrt(2.0)
"""The forces of a cell's two wheels are at right angles."""


def corner_pulls(
    traction: Traction, mass: Floats, inertia: Floats, radius: Floats, cells: Floats, gravity: float
) -> Floats:
    """Bounds on the accelerations of parcels' corners under a law of traction; see ``plant.kernels.meetings``.

    All forces add up at one end of the parcel, at the fastest slip: more than any motion comes to. Loads sum to the
    weight.

    Args:
        traction: the law.
        mass: ``(m,)`` kg.
        inertia: ``(m,)`` kg m², about the centre of mass.
        radius: ``(m,)`` m, of the farthest corner.
        cells: ``(m,)`` how many fit under each.
        gravity: m/s².

    Returns:
        ``(m, PULL_SIZE)``.
    """
    weight = mass * gravity
    yielding = BOTH_AXES * (1.0 / mass + radius * radius / inertia)
    stiffness = traction.stiffness_per_load * weight + traction.stiffness * cells
    bounds = np.zeros((len(mass), to.PULL_SIZE))
    bounds[:, to.PER_SLIP] = 1e300 if traction.set_valued else stiffness * yielding
    bounds[:, to.LIMIT] = (traction.limit_per_load * weight + traction.limit * cells) * yielding
    bounds[:, to.PUSH] = traction.push_per_load * weight * yielding
    bounds[:, to.RADIUS] = radius
    return bounds


def fastest(motion: WheelMotion) -> float:
    """Speed that no wheel's surface exceeds, along either axis, and that no cell's two wheels exceed together, m/s."""
    both = 0.0
    for part in (motion.steady, motion.decay):
        if part.size:
            both += max(float(part.max()), -float(part.min()))
    return BOTH_AXES * both
