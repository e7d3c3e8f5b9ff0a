"""Wheels of unequal friction (effect ``uneven_friction``): each has a factor for the law's traction by load.

Only a solver whose scene asks for it imports this; kernels for equal wheels are compiled without it.
"""

from __future__ import annotations

from plant.kernels.common.hooks import implements
from plant.kernels.implicit.traction_hooks import factor


@implements(factor, "factors", own=True)
def _factor(surface, cell):
    return surface.factors[cell, 0], surface.factors[cell, 1]
