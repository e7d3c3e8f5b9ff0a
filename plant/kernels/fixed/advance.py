"""The explicit solver's loop of one parcel: forces at a pose, and Runge-Kutta steps of one length.

Every stage of a step looks for its supports again, so the right-hand side is the one of the equations wherever it is
asked for. Nothing is located and no error is estimated.
"""

from __future__ import annotations

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.advance import finite
from plant.kernels.common.footprint import fill, sampled_until
from plant.kernels.implicit.balance_hooks import balance, begin_balance
from plant.kernels.implicit.step import EPSILON, grasp, pull, sign, unlimited
from plant.kernels.implicit.step_events import note_changes, note_outrun, remember
from plant.kernels.implicit.supports import decay, find_loads

NOW = 0.0
"""Forces are those of this instant, not those of an instant ahead. Named, for the compiler: see ``layout.ZERO``."""


@kernel
def sliding(row, w, isotropic):
    """Force of one cell's wheels under a set-valued law taken for a function: none at no slip, all of it else."""
    rx, ry = row[im.SX] - w[0] - row[im.AX] * w[2], row[im.SY] - w[1] - row[im.AY] * w[2]
    if isotropic == 0.0:
        return row[im.CX] * sign(rx), row[im.CY] * sign(ry)
    size = (rx * rx + ry * ry) ** 0.5
    if size == 0.0:
        return 0.0, 0.0
    return row[im.CX] * rx / size, row[im.CX] * ry / size


@kernel
def traction(surface, parcel, work, e):
    """Acceleration by the wheels at ``work.velocity`` under the loads found last: along x, along y, turning."""
    law, w = work.law, work.velocity
    count = grasp(surface, parcel, work, law, e, NOW)
    along_x = along_y = turn = 0.0
    for i in range(count):
        row = work.wheels[i]
        if law[im.SET_VALUED] == 0.0:
            force_x, force_y, _, _, _ = pull(row, w, law[im.ISOTROPIC])
        else:
            force_x, force_y = sliding(row, w, law[im.ISOTROPIC])
        beside_x, beside_y = unlimited(row, w)
        force_x += beside_x
        force_y += beside_y
        along_x += force_x
        along_y += force_y
        turn += row[im.AX] * force_x + row[im.AY] * force_y
    return along_x, along_y, turn


@kernel
def rate(surface, parcel, work, e, slope):
    """Time derivative of the state, into ``slope``; ``e`` is the motors' decay factor. Returns the status."""
    y, w, arm = parcel.y, work.velocity, work.pace[im.GYRATION]
    w[0], w[1], w[2] = y[at.UX], y[at.UY], arm * y[at.OMEGA]
    begin_balance(surface)
    instant = e, at.NOTHING, w[0], w[1], w[2]
    while True:
        along_x, along_y, turn = traction(surface, parcel, work, e)
        noise = 8.0 * EPSILON * (abs(along_x) + abs(along_y))
        status = balance(surface, parcel, work, instant, along_x, along_y, noise)
        if status != im.UNBALANCED:
            break
    slope[0], slope[1], slope[at.THETA] = y[at.UX], y[at.UY], y[at.OMEGA]
    slope[at.UX], slope[at.UY], slope[at.OMEGA] = along_x, along_y, turn / arm
    return status


@kernel
def checked_loads(surface, parcel, work):
    """Loads where the parcel is; one that is nowhere is not looked for. Returns the status."""
    if not finite(parcel.y):
        return at.NOT_FINITE
    return find_loads(surface, parcel, work)


@kernel
def step(surface, parcel, work, scheme, now, h):
    """One step of ``h`` seconds from a pose whose loads are found. Returns the status at its end.

    Where a stage on the way can't be carried the parcel stays at that stage; what is no number is taken back.
    """
    y, begin, slopes = parcel.y, work.begin, scheme.slopes
    stages, status = scheme.nodes.shape[0], at.MOVING
    for k in range(6):
        begin[k] = y[k]
    for s in range(stages):
        ahead = h * scheme.nodes[s]
        if s > 0:
            for k in range(6):
                y[k] = begin[k] + ahead * slopes[s - 1, k]
            status = checked_loads(surface, parcel, work)
            if status != at.MOVING:
                break
        status = rate(surface, parcel, work, decay(parcel.par, now + ahead), slopes[s])
        if status != at.MOVING:
            break
    if status == at.MOVING:
        for k in range(6):
            change = 0.0
            for s in range(stages):
                change += scheme.weights[s] * slopes[s, k]
            y[k] = begin[k] + h * change
        status = checked_loads(surface, parcel, work)
    if status == at.NOT_FINITE:
        for k in range(6):
            y[k] = begin[k]
    return status


@kernel
def advance(surface, parcel, work, scheme, stop, span, times, out, events):
    """Move one parcel by ``span`` seconds with the wheel velocities given.

    Args:
        surface: ``plant.kernels.common.surface.Surface``: the cells and their wheels.
        parcel: ``plant.kernels.common.parcels.Parcel``: footprint, constants and state; changed in place.
        work: ``plant.solvers.implicit.ImplicitWorkspace``: law of the parcel, and scratch.
        scheme: ``plant.solvers.fixed_step.Scheme``: the method's coefficients.
        stop: ``(1,)``: the call ends early once it is not 0; see ``plant.stop``.
        span: s; 0 only finds the loads and whether the parcel stands.
        times: ``(k,)`` s in ``(0, span]``, ascending: when states are asked for on the way; steps end there.
        out: ``(k, 6)``: those states.
        events: ``(capacity, 4)``: log.

    Returns:
        Seconds moved: ``span``, or less where the parcel tipped, the motion is unstable or the call was to end
        (``ctl[STATUS]``).
    """
    y, ctl, longest = parcel.y, parcel.ctl, work.pace[im.FIXED]
    now, sampled = 0.0, 0
    ctl[at.N_LOGGED] = 0
    ctl[at.STATUS] = checked_loads(surface, parcel, work)
    while now < span and ctl[at.STATUS] == at.MOVING:
        if stop[0] != 0:
            ctl[at.STATUS] = at.STOPPED
            break
        target = times[sampled] if sampled < times.shape[0] else span
        left = target - now
        # equal steps up to where a state is asked for, none longer than said
        h = left / max(1.0, -((1e-9 - left / longest) // 1.0))
        before = remember(parcel, work)
        status = step(surface, parcel, work, scheme, now, h)
        ctl[at.N_STEPS] += 1
        ctl[at.STATUS] = status
        if status == at.NOT_FINITE:
            break
        now = target if h >= left else now + h
        if status != at.MOVING:
            break
        note_changes(parcel, work, before, now, events)
        if work.law[im.PUSH_PER_SHARE] != 0.0:
            note_outrun(surface, parcel, work, now, decay(parcel.par, now), events)
        sampled = sampled_until(now, y, times, sampled, out)
    fill(y, times, sampled, out)
    return now
