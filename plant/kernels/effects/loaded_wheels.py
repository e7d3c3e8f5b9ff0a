"""Wheels that feel what they pull (effect ``wheel_load``): ``m (dV/dt + (V - V_ss) / tau) = -f``.

Only a solver whose scene asks for it imports this; kernels for wheels without inertia are compiled without it.

A wheel's surface speed is the motor's without load, known in closed form, plus a deviation D that begins at 0 with
the call: ``dD/dt = -D / tau - f / m``. With the force f of a step's end all through the step, per kilogram of the
parcel,

    D' = E D - rho f     E = exp(-h / tau)     rho = tau (1 - E) / (m / M)

so wheel and law together are a law again, of the slip against a wheel that the step leaves alone: its stiffness is
``1 / (1/b + rho)``, its limit the same, and nothing is set-valued. With a viscous part k beside the limited one and
``q = 1 + rho k`` they are ``1 / (q (q/b + rho))`` and ``c / q``, beside a viscous part ``k / q``. A push that goes by
the sign of the wheel's own speed is the force that brings the wheel to a stand, ``V / rho``, within its limit.
"""

from __future__ import annotations

from math import exp, expm1

from bus.kernel_cache.callee import kernel
from plant.kernels.common import implicit_layout as im
from plant.kernels.common import layout as at
from plant.kernels.common.advance import slope
from plant.kernels.common.hooks import implements
from plant.kernels.common.lag_hooks import add_lag, lag_sway, with_lag, with_lag_begun, with_lag_rate
from plant.kernels.implicit.dense import DEGREE, hermite
from plant.kernels.implicit.hooks import (
    begin_lags,
    begun,
    carry_lags,
    expand_lags,
    extrapolate,
    full,
    hand_over,
    keep,
    lighten,
    lightness,
    note_lag_slopes,
    note_lags,
    own_rates,
    recoil,
    slip_left,
    slow,
    speed,
    tabulate,
    take_back,
    unloaded,
)
from plant.kernels.implicit.step import pull, unclamped

SERIES = 1e-2
"""Below this many time constants a step's lag is summed as a series: its closed form cancels."""


@kernel
def within(value, limit):
    """The nearest to a value within a limit either way."""
    return max(-limit, min(limit, value))


@kernel
def lag(rate, h):
    """How far a wheel falls behind in ``h`` per unit of deceleration, s^2: ``tau (h - tau (1 - exp(-h / tau)))``."""
    x = rate * h
    if x < SERIES:
        return h * h * (0.5 - x * (1.0 / 6.0 - x * (1.0 / 24.0 - x * (1.0 / 120.0 - x / 720.0))))
    return (h + expm1(-x) / rate) / rate


@kernel
def enlist(slowing, cell):
    """Row of a cell's wheels, which until now run as the motors have it."""
    k = slowing.ctl[im.LISTED]
    slowing.ctl[im.LISTED] = k + 1
    slowing.place[cell], slowing.cell[k] = k, cell
    for c in range(im.SLOWED):
        slowing.now[k, c] = slowing.begin[k, c] = 0.0
        slowing.begun[k, c % 2] = slowing.ended[k, c % 2] = slowing.rates[k, c % 2] = 0.0
        for parts in range(slowing.table.shape[0]):
            slowing.table[parts, k, c] = 0.0
    return k


@implements(speed, "slowing", own=True)
def _speed(work, surface, cell, e):
    vx, vy = unloaded(surface, cell, e)
    k = work.slowing.place[cell]
    return (vx, vy) if k < 0 else (vx + work.slowing.now[k, 0], vy + work.slowing.now[k, 1])


@implements(begun, "slowing", own=True)
def _begun(work, surface, cell, e):
    vx, vy = unloaded(surface, cell, e)
    k = work.slowing.place[cell]
    return (vx, vy) if k < 0 else (vx + work.slowing.begin[k, 0], vy + work.slowing.begin[k, 1])


@implements(lightness, "slowing", own=True)
def _lightness(work):
    return 1.0 / work.law[im.WHEEL]


@implements(recoil, "slowing", own=True)
def _recoil(work, cell, axis, impulse):
    slowing = work.slowing
    k = slowing.place[cell]
    if k < 0:
        k = enlist(slowing, cell)
    slowing.now[k, axis] -= impulse / work.law[im.WHEEL]


@implements(lighten, "slowing", own=True)
def _lighten(work, parcel, row, cell, push_x, push_y, h):
    slowing, wheel, rate = work.slowing, work.wheels[row], parcel.par[at.RATE]
    k = slowing.place[cell]
    if k < 0:
        k = enlist(slowing, cell)
    slowing.row[row] = k
    left, rho = exp(-rate * h), -expm1(-rate * h) / rate / work.law[im.WHEEL]
    wheel[im.SX] += left * slowing.now[k, 0]
    wheel[im.SY] += left * slowing.now[k, 1]
    softer = 1.0 + rho * wheel[im.K]
    wheel[im.BX] = 1.0 / (softer * (softer / wheel[im.BX] + rho))
    wheel[im.BY] = 1.0 / (softer * (softer / wheel[im.BY] + rho))
    wheel[im.CX] /= softer
    wheel[im.CY] /= softer
    wheel[im.K] /= softer
    # what a wheel that slips is held to pull with
    wheel[im.GX] /= softer
    wheel[im.GY] /= softer
    wheel[im.SUMMED] += left * (abs(slowing.now[k, 0]) + abs(slowing.now[k, 1]))
    if work.law[im.PUSH_PER_SHARE] != 0.0:
        wheel[im.GX], wheel[im.GY] = within(wheel[im.SX] / rho, push_x), within(wheel[im.SY] / rho, push_y)


@implements(slip_left, "slowing", own=True)
def _slip_left(work, row, w, axis):
    # what exceeds a limit slips
    qx, qy = unclamped(row, w)
    fx, fy, _, _, _ = pull(row, w, work.law[im.ISOTROPIC])
    return (qx - fx) / row[im.BX] if axis == 0 else (qy - fy) / row[im.BY]


@implements(own_rates, "slowing", own=True)
def _own_rates(work, parcel, row, wheel):
    k, rate, inertia = work.slowing.row[row], parcel.par[at.RATE], work.law[im.WHEEL]
    for axis in range(2):
        lag = rate * work.slowing.now[k, axis]
        wheel[im.SX + axis] -= lag + wheel[im.OWN_X + axis] / inertia
        wheel[im.BX + axis] = inertia
        wheel[im.SUMMED] += abs(lag) + abs(wheel[im.OWN_X + axis]) / inertia


@implements(note_lags, "slowing", own=True)
def _note_lags(work, parcel, rows):
    slowing, rate, inertia = work.slowing, parcel.par[at.RATE], work.law[im.WHEEL]
    for k in range(slowing.ctl[im.LISTED]):
        for axis in range(2):
            slowing.ended[k, axis] = -rate * slowing.now[k, axis]
    for i in range(rows):
        wheel, k = work.wheels[i], slowing.row[i]
        fx, fy, _, _, _ = pull(wheel, work.velocity, work.law[im.ISOTROPIC])
        slowing.ended[k, 0] -= (fx + wheel[im.OWN_X]) / inertia
        slowing.ended[k, 1] -= (fy + wheel[im.OWN_Y]) / inertia


@implements(begin_lags, "slowing", own=True)
def _begin_lags(work):
    slowing = work.slowing
    for k in range(slowing.ctl[im.LISTED]):
        for axis in range(2):
            slowing.begun[k, axis] = slowing.rates[k, axis] = slowing.ended[k, axis]


@implements(expand_lags, "slowing", own=True)
def _expand_lags(work, h):
    slowing = work.slowing
    begin, now = slowing.begin, slowing.now
    for k in range(slowing.ctl[im.LISTED]):
        for axis in range(2):
            ends = begin[k, 2 + axis], begin[k, axis], now[k, 2 + axis], now[k, axis]
            rates = slowing.begun[k, axis], slowing.ended[k, axis]
            hermite(slowing.travel, slowing.series[k, axis], ends, rates, h)


@implements(note_lag_slopes, "slowing", own=True)
def _note_lag_slopes(work, first, h):
    slowing = work.slowing
    for k in range(slowing.ctl[im.LISTED]):
        for axis in range(2):
            slowing.rates[k, axis] = slope(slowing.series[k, axis], DEGREE - 1, first) / h


@implements(carry_lags, "slowing", own=True)
def _carry_lags(work, dt):
    slowing = work.slowing
    now, rates = slowing.now, slowing.rates
    for k in range(slowing.ctl[im.LISTED]):
        for axis in range(2):
            now[k, 2 + axis] += dt * (now[k, axis] + 0.5 * dt * rates[k, axis])
            now[k, axis] += dt * rates[k, axis]


@implements(with_lag, "slowing", own=True)
def _with_lag(work, cell, axis, speed):
    k = work.slowing.place[cell]
    return speed if k < 0 else speed + work.slowing.now[k, axis]


@implements(with_lag_begun, "slowing", own=True)
def _with_lag_begun(work, cell, axis, speed):
    k = work.slowing.place[cell]
    return speed if k < 0 else speed + work.slowing.begin[k, axis]


@implements(with_lag_rate, "slowing", own=True)
def _with_lag_rate(work, cell, axis, rate):
    k = work.slowing.place[cell]
    return rate if k < 0 else rate + work.slowing.rates[k, axis]


@implements(add_lag, "slowing", own=True)
def _add_lag(work, cell, axis, order, g):
    k = work.slowing.place[cell]
    if k >= 0:
        for j in range(min(order + 1, DEGREE)):
            g[j] += work.slowing.series[k, axis, j]


@implements(lag_sway, "slowing", own=True)
def _lag_sway(work, cell, axis):
    k, total = work.slowing.place[cell], 0.0
    if k >= 0:
        for j in range(1, DEGREE):
            total += abs(work.slowing.series[k, axis, j])
    return total


@implements(slow, "slowing", own=True)
def _slow(work, parcel, rows, h):
    slowing, rate = work.slowing, parcel.par[at.RATE]
    now, left, lasts = slowing.now, exp(-rate * h), -expm1(-rate * h) / rate
    for k in range(slowing.ctl[im.LISTED]):
        for c in range(2):
            now[k, 2 + c] += lasts * now[k, c]
            now[k, c] *= left
    behind, w = lag(rate, h), work.velocity
    for i in range(rows):
        wheel, k = work.wheels[i], slowing.row[i]
        fx, fy, _, _, _ = pull(wheel, w, work.law[im.ISOTROPIC])
        # what else resists the parcel's motion does not act on the wheel
        fx += wheel[im.GX] - wheel[im.OWN_K] * (w[0] + wheel[im.AX] * w[2])
        fy += wheel[im.GY] - wheel[im.OWN_K] * (w[1] + wheel[im.AY] * w[2])
        ax, ay = fx / work.law[im.WHEEL], fy / work.law[im.WHEEL]
        now[k, 0] -= lasts * ax
        now[k, 1] -= lasts * ay
        now[k, 2] -= behind * ax
        now[k, 3] -= behind * ay


@kernel
def copy(slowing, source, target):
    """Copy the listed wheels' rows."""
    for k in range(slowing.ctl[im.LISTED]):
        for c in range(im.SLOWED):
            target[k, c] = source[k, c]


@implements(keep, "slowing", own=True)
def _keep(work):
    copy(work.slowing, work.slowing.now, work.slowing.begin)


@implements(take_back, "slowing", own=True)
def _take_back(work):
    copy(work.slowing, work.slowing.begin, work.slowing.now)


@implements(tabulate, "slowing", own=True)
def _tabulate(work, row):
    copy(work.slowing, work.slowing.now, work.slowing.table[row])


@implements(extrapolate, "slowing", own=True)
def _extrapolate(work, lasts):
    slowing, table, worst = work.slowing, work.slowing.table, 0.0
    for k in range(slowing.ctl[im.LISTED]):
        for c in range(im.SLOWED):
            last = table[3, k, c]
            one, two, three = table[0, k, c] - last, table[1, k, c] - last, table[2, k, c] - last
            slowing.now[k, c] = last - one / 6.0 + 4.0 * two - 13.5 * three
            error = abs(-one / 6.0 + 2.0 * two - 4.5 * three)
            worst = max(worst, error * lasts if c < 2 else error)
    return worst


@implements(full, "slowing", own=True)
def _full(work):
    slowing = work.slowing
    return slowing.ctl[im.WRITTEN] + slowing.cell.shape[0] > slowing.written.shape[0]


@implements(hand_over, "slowing", own=True)
def _hand_over(work, parcel, left):
    slowing = work.slowing
    slow(work, parcel, at.ZERO, left)
    first = slowing.ctl[im.WRITTEN]
    for k in range(slowing.ctl[im.LISTED]):
        cell = slowing.cell[k]
        slowing.place[cell] = -1
        slowing.which[first + k] = cell
        for c in range(im.SLOWED):
            slowing.written[first + k, c] = slowing.now[k, c]
    slowing.ctl[im.WRITTEN] = first + slowing.ctl[im.LISTED]
    slowing.ctl[im.LISTED] = 0
