"""Rollers that strike the parcel (effect ``roller_impacts``): an impulse for every roller that passes under it.

Only a solver whose scene asks for it imports this; kernels for smooth wheels are compiled without it.

Each wheel counts the slip that has passed along its axis, in spacings from where its roller stood at the start. Steps
are so short that no count grows by more than ``PART``; a roller that passed strikes at the step's end, so much late.
Impulses of one instant act one after another, each on the slip that the others left, and none by more than stops that.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import layout as at
from plant.kernels.common.branches import lever
from plant.kernels.common.hooks import implements
from plant.kernels.common.springs import gap, plane_at, stiffness
from plant.kernels.common.step_end import allowed, rollers_under, strike
from plant.kernels.common.surface import Rollers
from plant.kernels.implicit.hooks import begun, lightness, recoil, speed, unloaded
from plant.kernels.implicit.supports import decay

PART = 0.25
"""Longest step, in spacings of slip at the fastest wheel."""
SHORTEST = 1e-5
"""Rollers may pass more than one in a step where it would have to be shorter, s: each still strikes."""


@implements(rollers_under, "rollers", own=True)
def _own(surface, i):
    of = surface.rollers
    return Rollers(of.spacing_m, of.impulse_m_s, of.start, of.passed[i])


@implements(allowed, "rollers", own=True)
def _one_roller(surface, parcel, work, now, h):
    fastest, way_m = fastest_slip(surface, parcel, work, now), PART * surface.rollers.spacing_m
    return h if fastest * h <= way_m else min(h, max(way_m / fastest, SHORTEST))


@implements(strike, "rollers", own=True)
def _strike(surface, parcel, work, now, h):
    before, after = decay(parcel.par, now), decay(parcel.par, now + h)
    rollers, mem = surface.rollers, parcel.mem
    # the way that passed is that of the step, not yet changed by what strikes at its end
    for k in range(6):
        work.end[k] = parcel.y[k]
    a0, bx, by = plane_at(surface, work.seg, -work.seg[at.CX], -work.seg[at.CY])
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = mem[i, at.CELL]
        if mem[i, at.MARK] != at.ACTIVE or surface.grip[cell] == 0.0:
            continue
        rx = surface.pos[cell, 0] - parcel.y[0] - work.seg[at.CX]
        ry = surface.pos[cell, 1] - parcel.y[1] - work.seg[at.CY]
        share = max(stiffness(surface, cell, i) * (a0 + bx * rx + by * ry - gap(surface, cell)), 0.0)
        for axis in range(2):
            slip = slip_at(begun(work, surface, cell, before), surface, work.begin, cell, axis)
            slip_after = slip_at(speed(work, surface, cell, after), surface, work.end, cell, axis)
            hit = strike_rollers(rollers, cell, axis, 0.5 * h * (slip + slip_after))
            if hit != 0.0:
                push(surface, parcel, work, after, cell, axis, hit * rollers.impulse_m_s * share)


@kernel
def slip_at(wheels, surface, y, cell, axis):
    """Slip along an axis of a cell's wheels, which run at ``wheels`` (vx, vy), m/s."""
    return wheels[axis] - y[at.UX + axis] - lever(surface, y, cell, axis) * y[at.OMEGA]


@kernel
def fastest_slip(surface, parcel, work, now):
    """Speed that no slip under the parcel exceeds as the motors settle, nor any corner's way over the cells, m/s."""
    y, e = parcel.y, decay(parcel.par, now)
    fastest = (y[at.UX] * y[at.UX] + y[at.UY] * y[at.UY]) ** 0.5 + parcel.par[at.RADIUS] * abs(y[at.OMEGA])
    for i in range(parcel.ctl[at.N_MEMBERS]):
        cell = parcel.mem[i, at.CELL]
        if parcel.mem[i, at.MARK] == at.ACTIVE and surface.grip[cell] != 0.0:
            wheels, without = speed(work, surface, cell, e), unloaded(surface, cell, e)
            for axis in range(2):
                # what is left of the motors' transient goes, and what a load took comes back: the wheel's speed stays
                # between these
                slip = slip_at(without, surface, y, cell, axis)
                fastest = max(fastest, abs(slip), abs(slip - e * surface.decay[cell, axis]))
                fastest = max(fastest, abs(slip_at(wheels, surface, y, cell, axis)))
    return fastest


@kernel
def strike_rollers(rollers, cell, axis, way):
    """Let ``way`` metres of slip pass at a wheel. Returns how many rollers passed, with the slip's sign."""
    if way == 0.0:
        return 0.0
    passed = rollers.passed[cell, axis] + way / rollers.spacing_m
    hit = (rollers.start[cell, axis] + passed) // 1.0
    rollers.passed[cell, axis] = passed - hit
    return hit


@kernel
def push(surface, parcel, work, e, cell, axis, impulse):
    """Strike the parcel at a wheel along an axis, by at most what stops the slip there; ``impulse`` per kg, m/s.

    A wheel that feels what it pulls is hit back.
    """
    y, per_inertia = parcel.y, parcel.par[at.MASS_OVER_INERTIA]
    arm = lever(surface, y, cell, axis)
    slip = slip_at(speed(work, surface, cell, e), surface, y, cell, axis)
    stops = slip / (1.0 + arm * arm * per_inertia + lightness(work))
    given = min(max(stops, 0.0), impulse) if impulse > 0.0 else max(min(stops, 0.0), impulse)
    y[at.UX + axis] += given
    y[at.OMEGA] += arm * given * per_inertia
    recoil(work, cell, axis, given)
