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

While chatter is captured every mode has its own traction, and so its own shift (Filippov). A wheel whose force its slip
does not give sticks on average over the modes: in each it pulls with the same share of its limit there.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.branches import pulls
from plant.kernels.common.hooks import implements
from plant.kernels.common.loads import settle
from plant.kernels.common.springs import shift, shift_alike, transfer_under, unshift
from plant.kernels.common.surface import Transfer
from plant.kernels.implicit.balance_hooks import balance, begin_balance
from plant.kernels.implicit.step import list_wheels, pull, share_in, unlimited

PASSES = 200
EXACT = 1e-14
"""A shift is found to this share of the parcel's radius, ..."""
ROUGH = 1e-9
"""... or to this where modes mix and passes no longer come nearer: forces that hold sticking wheels are rounded."""
SLOW = 0.7
"""A pass that leaves more than this share of what it was off by is too long."""
SHORTEST = 1e-3
"""Share of a correction that is always taken."""
PASSED, OFF, SHARE = range(3)
FROM_X, FROM_Y, BY_X, BY_Y = range(4)


@implements(transfer_under, "transfer", own=True)
def _own(surface, i):
    of = surface.transfer
    return Transfer(of.lever_s2[i], of.shift[i], of.change[i], of.memory[i])


@implements(shift, "transfer", own=True)
def _shift(surface, m):
    return surface.transfer.shift[m, 0], surface.transfer.shift[m, 1]


@implements(unshift, "transfer", own=True)
def _unshift(surface, m):
    stands = surface.transfer.shift[m]
    there = stands[0] != 0.0 or stands[1] != 0.0
    stands[0] = stands[1] = 0.0
    return there


@implements(shift_alike, "transfer", own=True)
def _shift_alike(surface, m, other):
    stands = surface.transfer.shift
    stands[m, 0], stands[m, 1] = stands[other, 0], stands[other, 1]


@implements(begin_balance, "transfer", own=True)
def _begin(surface):
    memory = surface.transfer.memory
    memory[PASSED], memory[OFF], memory[SHARE] = 0.0, 1e300, 1.0


@kernel
def traction_in(surface, parcel, work, m, instant):
    """Acceleration by the traction of mode m alone (x, y), m/s^2, by the wheels of the problem just solved."""
    e, h, ux, uy, turning = instant
    law, v = work.law, (ux, uy, turning)
    by_modes = law[im.CAPTURES] == im.BY_MODES
    # a row that no list of wheels reaches
    spare = work.wheels.shape[0] - 1
    ax, ay, row = 0.0, 0.0, at.ZERO
    for i in range(parcel.ctl[at.N_MEMBERS]):
        if not pulls(surface, parcel, i):
            continue
        mean = work.wheels[row]
        row += 1
        share, part = share_in(surface, parcel, work, i, m, False)
        if part == 0.0:
            continue
        list_wheels(surface, parcel, work, law, e, h, i, m if by_modes else at.ZERO, spare, share, part)
        wheel = work.wheels[spare]
        if law[im.SET_VALUED] != 0.0:
            fx = mean[im.LX] * wheel[im.CX] / mean[im.CX] if mean[im.CX] > 0.0 else 0.0
            fy = mean[im.LY] * wheel[im.CY] / mean[im.CY] if mean[im.CY] > 0.0 else 0.0
        else:
            fx, fy, _, _, _ = pull(wheel, v, law[im.ISOTROPIC])
        gx, gy = unlimited(wheel, v)
        ax += fx + gx
        ay += fy + gy
    return ax, ay


@kernel
def corrections(surface, parcel, work, instant, ax, ay):
    """How each mode's shift is to change, into ``change``. Returns the largest such change, m."""
    of, groups, most = surface.transfer, parcel.ctl[at.N_GROUPS], 0.0
    for m in range(1 << groups):
        if groups > 0:
            ax, ay = traction_in(surface, parcel, work, m, instant)
        x, y = of.shift[m, 0], of.shift[m, 1]
        dx, dy = -of.lever_s2 * ax - x, -of.lever_s2 * ay - y
        of.change[m, FROM_X], of.change[m, FROM_Y], of.change[m, BY_X], of.change[m, BY_Y] = x, y, dx, dy
        off = (dx * dx + dy * dy) ** 0.5
        # no number is the largest of all
        most = off if not off <= most else most
    return most


@kernel
def move(surface, parcel, work, share):
    """Take a ``share`` of every mode's correction, and find the loads. Returns the status."""
    of = surface.transfer
    for m in range(1 << parcel.ctl[at.N_GROUPS]):
        change = of.change[m]
        of.shift[m, 0], of.shift[m, 1] = (
            change[FROM_X] + share * change[BY_X],
            change[FROM_Y] + share * change[BY_Y],
        )
        status = settle(surface, parcel, work.segs[m], at.MARK + m, work.scratch, work.newton)
        if status != at.MOVING:
            return status
    return at.MOVING


@implements(balance, "transfer", own=True)
def _balance(surface, parcel, work, instant, ax, ay, noise):
    of, par = surface.transfer, parcel.par
    memory = of.memory
    off = corrections(surface, parcel, work, instant, ax, ay)
    if off <= EXACT * par[at.RADIUS] + of.lever_s2 * noise:
        return at.MOVING
    slowly = off > SLOW * memory[OFF]
    if slowly and parcel.ctl[at.N_GROUPS] > 0 and off <= ROUGH * par[at.RADIUS]:
        return at.MOVING
    if memory[PASSED] >= PASSES or not off < 1e300:
        return im.NOT_SOLVED
    if slowly:
        memory[SHARE] = max(0.5 * memory[SHARE], SHORTEST)
    memory[PASSED] += 1.0
    memory[OFF] = off
    share = memory[SHARE]
    while move(surface, parcel, work, share) != at.MOVING:
        share *= 0.5
        if share * off <= par[at.ON_LINE]:
            # as far as loads balance, and the traction asks for more
            return at.TIPPED
    return im.UNBALANCED
