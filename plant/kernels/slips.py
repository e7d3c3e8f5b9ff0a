"""The slip of single wheels along a step: wheel speed less that of the parcel's underside above it, as a polynomial.

Sums over a support set tell the motion; only where a wheel changes to another branch of the law, or is outrun, does
its own slip matter. Series are in unit time here, as in ``events``.
"""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel
from plant.kernels.series import product

ROUNDING = 1e-14
"""A share of the speeds around that is none to rounding."""


@kernel
def underside(ser, order, step):
    """Series of the velocity of the parcel's underside above ``X0``; the motors' decay into unit time."""
    scale = 1.0
    for k in range(1, order + 1):
        scale *= step
        ser[at.S_EXP, k] *= scale
    for k in range(order + 1):
        ser[at.S_VX, k] = ser[at.S_UX, k] + product(ser, at.S_OM, at.S_Y, k)
        ser[at.S_VY, k] = ser[at.S_UY, k] - product(ser, at.S_OM, at.S_X, k)


@kernel
def lever(surface, y, cell, axis):
    """Velocity along an axis, m/s, of the underside above a cell for every rad/s of turning."""
    return surface.pos[cell, 0] - y[0] if axis == 1 else y[1] - surface.pos[cell, 1]


@kernel
def slip_now(surface, y, free, e, cell, axis):
    """A wheel's slip now, and a speed that rounding can't tell from none beside it, m/s.

    ``free`` is the share of its surface speed at which the wheel would run without load.
    """
    steady, decay = free * surface.steady[cell, axis], free * surface.decay[cell, axis]
    turn = lever(surface, y, cell, axis) * y[at.OMEGA]
    along = y[at.UX + axis]
    zero = ROUNDING * (abs(steady) + e * abs(decay) + abs(along) + abs(turn))
    return steady + e * decay - along - turn, zero


@kernel
def slip_polynomial(surface, y, free, ser, order, cell, axis, g):
    """A wheel's slip along the step, m/s: coefficients into ``g``."""
    steady, decay = free * surface.steady[cell, axis], free * surface.decay[cell, axis]
    arm, row = lever(surface, y, cell, axis), at.S_VX + axis
    for k in range(order + 1):
        g[k] = decay * ser[at.S_EXP, k] - ser[row, k] - arm * ser[at.S_OM, k]
    g[0] += steady


@kernel
def sway(ser, order, row):
    """Bound on how far a series departs from its start within the unit step."""
    total = 0.0
    for k in range(1, order + 1):
        total += abs(ser[row, k])
    return total
