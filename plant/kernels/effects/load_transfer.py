"""Loads shifted by traction below a raised centre of mass (effect ``load_transfer``).

Only a solver whose scene asks for it imports this; kernels for flat parcels are compiled without it.

Traction acts a height H below the centre of mass. Without angular acceleration about x and y, moments about the centre
of mass balance as

    sum N_i (p_i - X) = -H F        F = m a, the whole traction

so the loads are those of a load's centre at ``X + s``, ``s = -(H / g) a`` (eqs. 3-13 with that centre in place of X).
Traction depends on the loads: s is found by iteration, ``s <- s + t (T(s) - s)`` with T(s) what the traction under the
loads of s asks for. With f the largest traction per newton of load (mu, or mu times the slip), l the parcel's radius of
gyration, R its farthest wheel and rho the least radius of gyration of the supports, T changes by at most
``q = H f sqrt(1 + R^2 / l^2) / rho`` times the change of s: loads change by the inverse of the supports' moments, and a
step's velocity is a proximal map of the traction, which does not expand. Where q < 1 the iteration converges with
t = 1. Where it converges too slowly t is halved, and so it is where no loads balance on the way.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.hooks import implements
from plant.kernels.common.loads import settle
from plant.kernels.common.springs import shift, transfer_under, unshift
from plant.kernels.common.surface import Transfer
from plant.kernels.implicit.balance_hooks import balance, begin_balance

PASSES = 200
EXACT = 1e-14
"""A shift is found to this share of the parcel's radius."""
SLOW = 0.7
"""A pass that leaves more than this share of what it was off by is too long."""
SHORTEST = 1e-3
"""Share of a correction that is always taken."""
PASSED, OFF, SHARE = range(3)


@implements(transfer_under, "transfer", own=True)
def _own(surface, i):
    of = surface.transfer
    return Transfer(of.lever_s2[i], of.shift[i], of.memory[i])


@implements(shift, "transfer", own=True)
def _shift(surface):
    return surface.transfer.shift[0], surface.transfer.shift[1]


@implements(unshift, "transfer", own=True)
def _unshift(surface):
    there = surface.transfer.shift[0] != 0.0 or surface.transfer.shift[1] != 0.0
    surface.transfer.shift[0] = surface.transfer.shift[1] = 0.0
    return there


@implements(begin_balance, "transfer", own=True)
def _begin(surface):
    memory = surface.transfer.memory
    memory[PASSED], memory[OFF], memory[SHARE] = 0.0, 1e300, 1.0


@kernel
def move(surface, parcel, work, x, y):
    """Take the load's centre to be (x, y) from the centre of mass, and find the loads. Returns the status."""
    surface.transfer.shift[0], surface.transfer.shift[1] = x, y
    return settle(surface, parcel, work.seg, at.MARK, work.scratch, work.newton)


@implements(balance, "transfer", own=True)
def _balance(surface, parcel, work, ax, ay, noise):
    of, par = surface.transfer, parcel.par
    memory, x, y = of.memory, of.shift[0], of.shift[1]
    dx, dy = -of.lever_s2 * ax - x, -of.lever_s2 * ay - y
    off = (dx * dx + dy * dy) ** 0.5
    if off <= EXACT * par[at.RADIUS] + of.lever_s2 * noise:
        return at.MOVING
    if memory[PASSED] >= PASSES or not off < 1e300:
        return im.NOT_SOLVED
    if off > SLOW * memory[OFF]:
        memory[SHARE] = max(0.5 * memory[SHARE], SHORTEST)
    memory[PASSED] += 1.0
    memory[OFF] = off
    share = memory[SHARE]
    while move(surface, parcel, work, x + share * dx, y + share * dy) != at.MOVING:
        share *= 0.5
        if share * off <= par[at.ON_LINE]:
            # as far as loads balance, and the traction asks for more
            return at.TIPPED
    return im.UNBALANCED
