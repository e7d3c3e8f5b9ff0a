"""Static friction above the kinetic one (``static_coefficient`` of the law ``coulomb``).

Only a solver whose scene asks for it imports this; kernels for one coefficient are compiled without it.

Each wheel sticks or slips in one direction. A wheel that sticks has the static limit, and lets go where it would take
more to hold it; one that slips has the kinetic limit until its slip is zero, and sticks from there unless that takes
more than the static limit. The force is then no gradient of a potential, but each step is a sequence of problems that
are convex, each wheel with the limit of what it does: those that would slip beyond the static limit are let go, those
whose slip turned round are held, and the step is solved again until neither happens. In one step a wheel is caught at
most once and then let go at most once, and a wheel that was let go is not caught, so the sequence ends.

Controlled steps on wheels that slip independently need none of this: ``plant.kernels.implicit.slips`` has them end
before a wheel lets go.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.branches import lever
from plant.kernels.common.hooks import implements
from plant.kernels.common.springs import stiction_under
from plant.kernels.common.surface import Stiction
from plant.kernels.implicit.hooks import speed, summed
from plant.kernels.implicit.step import AGREED, new_velocity, pull, unclamped
from plant.kernels.implicit.stiction_hooks import commit_grips, find_velocity, keep_grips, restore_grips

CELL, ALONG_X, ALONG_Y = range(3)
"""Columns of a grip: the cell, and the sign of the slip at each of its wheels, 0 of one that sticks.

Wheels that share a limit stick where both signs are 0.
"""


@implements(stiction_under, "stiction", own=True)
def _own(surface, i):
    of = surface.stiction
    return Stiction(of.ratio, of.grips[i], of.counts[i], of.begun[i], of.found[i], of.limits[i], of.caught[i])


@implements(commit_grips, "stiction", own=True)
def _commit(surface, work, count):
    of = surface.stiction
    if work.law[im.LOCATED] != 0.0:
        return
    copy(of.found, of.grips, count)
    of.counts[0] = count


@implements(keep_grips, "stiction", own=True)
def _keep(surface, parcel, work, e):
    of, free = surface.stiction, work.law[im.FREE_SPEED]
    if work.law[im.LOCATED] != 0.0:
        return
    look_up(of, work.where)
    count = 0
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = parcel.mem[i, at.CELL]
        if parcel.mem[i, at.MARK] == at.ACTIVE and surface.grip[cell] != 0.0:
            grip = of.begun[count]
            grip[CELL] = cell
            if not known(grip, work.where[cell]):
                vx, vy = speed(work, surface, cell, e)
                slip_x = free * vx - parcel.y[at.UX] - lever(surface, parcel.y, cell, 0) * parcel.y[at.OMEGA]
                slip_y = free * vy - parcel.y[at.UY] - lever(surface, parcel.y, cell, 1) * parcel.y[at.OMEGA]
                size = free * summed(surface, cell, e) + abs(parcel.y[at.UX]) + abs(parcel.y[at.UY])
                size += parcel.par[at.RADIUS] * abs(parcel.y[at.OMEGA])
                meet(grip, slip_x, slip_y, AGREED * size)
            count += 1
    forget(of, work.where)
    of.counts[1] = count
    copy(of.begun, of.grips, count)
    of.counts[0] = count


@implements(restore_grips, "stiction", own=True)
def _restore(surface, work):
    of = surface.stiction
    if work.law[im.LOCATED] != 0.0:
        return
    copy(of.begun, of.grips, of.counts[1])
    of.counts[0] = of.counts[1]


@kernel
def copy(source, target, count):
    """Copy the first grips of a list."""
    for i in range(count):
        for k in range(3):
            target[i, k] = source[i, k]


@kernel
def slip_of(row, w):
    """Slip at a cell's wheels (x, y) at the velocity ``w``, by the force that they would take."""
    return row[im.SX] - w[0] - row[im.AX] * w[2], row[im.SY] - w[1] - row[im.AY] * w[2]


@kernel
def direction(slip, zero):
    """Sign of a slip as an integer; 0 of one that is none to rounding."""
    if slip > zero:
        return 1
    return -1 if slip < -zero else at.ZERO


@kernel
def speeds(row, w):
    """Size of the speeds around a wheel."""
    return row[im.SUMMED] + abs(w[0]) + abs(w[1]) + abs(w[2])


@kernel
def look_up(of, where):
    """Have ``where`` tell how each cell's wheels hold the parcel, as a code; 0 of cells that don't."""
    for k in range(of.counts[0]):
        where[of.grips[k, CELL]] = 5 + of.grips[k, ALONG_X] + 3 * of.grips[k, ALONG_Y]


@kernel
def forget(of, where):
    """Clear what ``look_up`` left."""
    for k in range(of.counts[0]):
        where[of.grips[k, CELL]] = 0


@kernel
def known(grip, code):
    """Fill in a grip from a code of ``look_up``. Returns whether the cell has a grip."""
    if code == 0:
        return False
    grip[ALONG_X], grip[ALONG_Y] = (code - 1) % 3 - 1, (code - 1) // 3 - 1
    return True


@kernel
def meet(grip, slip_x, slip_y, zero):
    """Fill in the grip of wheels that the parcel meets: they stick where they don't slip."""
    grip[ALONG_X], grip[ALONG_Y] = direction(slip_x, zero), direction(slip_y, zero)


@kernel
def recall(surface, parcel, work, isotropic):
    """List in ``found`` how the wheels of ``work.wheels`` hold the parcel at the start of the part to be solved."""
    of, mem, where = surface.stiction, parcel.mem, work.where
    look_up(of, where)
    row = 0
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        if mem[i, at.MARK] != at.ACTIVE or surface.grip[cell] == 0.0:
            continue
        wheel, grip = work.wheels[row], of.found[row]
        grip[CELL] = cell
        if not known(grip, where[cell]):
            slip_x, slip_y = slip_of(wheel, work.start)
            meet(grip, slip_x, slip_y, AGREED * speeds(wheel, work.start))
        for axis in range(2):
            of.limits[row, axis] = wheel[im.CX + axis]
            of.caught[row, axis] = 0
            other = 0 if isotropic == 0.0 else grip[ALONG_Y - axis]
            if grip[ALONG_X + axis] == 0 and other == 0:
                wheel[im.CX + axis] *= of.ratio
        row += 1
    forget(of, where)


@kernel
def turn(of, wheel, i, axis, now):
    """Take a wheel that slips as ``now`` says at the end of the step. Returns whether to solve the step again."""
    before = of.found[i, ALONG_X + axis]
    if before == now:
        return False
    if before != 0 and now == 0:
        # the kinetic limit holds it at the end
        of.found[i, ALONG_X + axis] = 0
        return False
    if before == 0:
        of.found[i, ALONG_X + axis], of.caught[i, axis] = now, 1
        wheel[im.CX + axis] = of.limits[i, axis]
        return True
    if of.caught[i, axis] != 0:
        of.found[i, ALONG_X + axis] = now
        return False
    of.caught[i, axis] = 1
    of.found[i, ALONG_X + axis] = 0
    wheel[im.CX + axis] = of.ratio * of.limits[i, axis]
    return True


@kernel
def turn_both(of, wheel, i, slip_x, slip_y, zero):
    """As ``turn``, of wheels that share a limit."""
    grip = of.found[i]
    stuck, back = (
        grip[ALONG_X] == 0 and grip[ALONG_Y] == 0,
        slip_x * grip[ALONG_X] + slip_y * grip[ALONG_Y] < 0.0,
    )
    meet(grip, slip_x, slip_y, zero)
    slips = grip[ALONG_X] != 0 or grip[ALONG_Y] != 0
    if stuck and slips:
        wheel[im.CX] = wheel[im.CY] = of.limits[i, 0]
    elif back and slips and of.caught[i, 0] == 0:
        grip[ALONG_X] = grip[ALONG_Y] = 0
        wheel[im.CX] = wheel[im.CY] = of.ratio * of.limits[i, 0]
    else:
        return False
    of.caught[i, 0] = 1
    return True


@kernel
def turn_all(of, work, count, isotropic, w):
    """Take all wheels as they slip at the end of the step. Returns whether to solve the step again."""
    again = False
    for i in range(count):
        wheel = work.wheels[i]
        qx, qy = unclamped(wheel, w)
        fx, fy, _, _, _ = pull(wheel, w, isotropic)
        # what exceeds the limit slips, whether the law is set-valued or the wheel gives way
        slip_x, slip_y = (qx - fx) / wheel[im.BX], (qy - fy) / wheel[im.BY]
        zero = AGREED * speeds(wheel, w)
        if isotropic == 0.0:
            again = turn(of, wheel, i, 0, direction(slip_x, zero)) or again
            again = turn(of, wheel, i, 1, direction(slip_y, zero)) or again
            continue
        again = turn_both(of, wheel, i, slip_x, slip_y, zero) or again
    return again


@implements(find_velocity, "stiction", own=True)
def _find(surface, parcel, work, count, h, w):
    of, isotropic = surface.stiction, work.law[im.ISOTROPIC]
    if work.law[im.LOCATED] != 0.0:
        # the step's begin says which wheels stick, and its end comes before one of them lets go
        for i in range(count):
            if work.wheels[i, im.SLIPS] == 0.0:
                work.wheels[i, im.CX] *= of.ratio
                work.wheels[i, im.CY] *= of.ratio
        return new_velocity(work, count, work.law, h, w)
    recall(surface, parcel, work, isotropic)
    for _ in range(4 * count + 1):
        if not new_velocity(work, count, work.law, h, w):
            return False
        if not turn_all(of, work, count, isotropic, w):
            break
    return True
