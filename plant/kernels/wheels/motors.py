"""First-order motors of all wheels, in one pass over them: see ``plant.effects.motors``.

Exponentials and logarithms are the C library's, as in ``bus.elementary``.
"""

from __future__ import annotations

from math import exp, expm1, inf, isfinite, log1p

from bus.kernel_cache.callee import kernel

STILL_M_S = 1e-15
"""A wheel slower than this stands: where it stopped, rounding leaves less."""


@kernel
def motion_of(speed, volts, law):
    """Steady and decaying part of a wheel's speed under a voltage, until it stops; ``law``: gain, coulomb, static."""
    gain, coulomb, static = law[0], law[1], law[2]
    if static == 0.0:
        steady = gain * volts
        return steady, speed - steady
    moves = abs(speed) > STILL_M_S
    if not (moves or abs(volts) > static):
        return 0.0, 0.0
    towards = speed if moves else volts
    direction = 1.0 if towards > 0.0 else (-1.0 if towards < 0.0 else 0.0)
    steady = gain * (volts - coulomb * direction)
    return steady, speed - steady


@kernel
def limited(drives, supply, volts):
    """Fill ``volts`` with the drives ``(n, 2)`` that the supply allows."""
    for i in range(drives.shape[0]):
        for w in range(2):
            volts[i, w] = min(max(drives[i, w], -supply), supply)


@kernel
def delayed(volts, before, acts, first, begun):
    """Find the wheels whose voltage changes after the start.

    Args:
        volts: ``(n, 2)`` new ones.
        before: ``(n, 2)`` old ones.
        acts: ``(n,)`` when a cell's new ones act, s.
        first: ``(n, 2)``; is filled with the voltages at the start.
        begun: ``(n, 2)``; is filled with when the new voltages act; infinite where they act at once, or are the old.

    Returns:
        Whether there are such wheels.
    """
    found = False
    for i in range(volts.shape[0]):
        late = acts[i] > 0.0
        for w in range(2):
            if late and volts[i, w] != before[i, w]:
                found = True
                first[i, w], begun[i, w] = before[i, w], acts[i]
            else:
                first[i, w], begun[i, w] = volts[i, w], inf
    return found


@kernel
def set_off(speed, volts, law, steady, decay, log_ratio):
    """Fill in the motion of all wheels ``(n, 2)`` at a speed under voltages, until they stop.

    Args:
        speed: m/s.
        volts: within the supply's limits.
        law: ``(3,)``: gain, voltage of friction, voltage that starts a wheel.
        steady: m/s.
        decay: m/s.
        log_ratio: is filled with ln(1 + speed by steady speed) where a wheel is to stop on its way to the other side,
            else with infinity.

    Returns:
        Whether some wheel may stop.
    """
    stops = False
    for i in range(speed.shape[0]):
        for w in range(2):
            v = speed[i, w]
            s, decay[i, w] = motion_of(v, volts[i, w], law)
            steady[i, w], log_ratio[i, w] = s, inf
            if law[2] != 0.0 and abs(v) > STILL_M_S and ((v > 0.0 and s < 0.0) or (v < 0.0 and s > 0.0)):
                log_ratio[i, w] = log1p(abs(v) / abs(s))
                stops = True
    return stops


@kernel
def stand(volts, law, steady, decay):
    """Fill in the motion of all wheels ``(n, 2)`` that have stopped, under voltages."""
    for i in range(volts.shape[0]):
        for w in range(2):
            steady[i, w], decay[i, w] = motion_of(0.0, volts[i, w], law)


@kernel
def stop_s(speed, steady, tau, static):
    """After how many seconds a wheel stops on its way from a speed to a steady one; infinite: it doesn't."""
    crosses = (speed > 0.0 and steady < 0.0) or (speed < 0.0 and steady > 0.0)
    if static != 0.0 and abs(speed) > STILL_M_S and crosses:
        return tau * log1p(abs(speed) / abs(steady))
    return inf


@kernel
def go_over(speed, first, volts, acts, span, law, tau, steady, decay, after, steadies, decays):
    """Fill in the motion of all wheels ``(n, 2)`` that go over from first voltages to others.

    Args:
        speed: Speeds at the start, m/s.
        first: Voltages at the start.
        volts: Voltages from ``acts`` on.
        acts: When these act, s; infinite where the first ones stay.
        span: End of the motion, s.
        law: ``(3,)``: gain, voltage of friction, voltage that starts a wheel.
        tau: Time constant, s.
        steady: Steady part of the speed at the start, m/s; is filled.
        decay: Decaying part, m/s; is filled.
        after: ``(3, n, 2)``; is filled with the times of changes, s: of wheels that stop before, of those that go over,
            of those that stop after. Rows of stops are left out where no wheel stops.
        steadies: ``(3, n, 2)``; is filled with the steady parts after the changes, m/s.
        decays: ``(3, n, 2)``; is filled with the decaying parts.

    Returns:
        Number of rows.
    """
    stops, rate = False, 1.0 / tau
    for i in range(speed.shape[0]):
        for w in range(2):
            v = speed[i, w]
            steady[i, w], decay[i, w] = motion_of(v, first[i, w], law)
            stopped_s = stop_s(v, steady[i, w], tau, law[2])
            stopped = stopped_s < min(acts[i, w], span)
            stops = stops or stopped
            after[0, i, w] = stopped_s if stopped else inf
            steadies[0, i, w], decays[0, i, w] = motion_of(0.0, first[i, w], law)
    row, stops_after = 1 if stops else 0, False
    for i in range(speed.shape[0]):
        for w in range(2):
            at = acts[i, w] if isfinite(acts[i, w]) else 0.0
            v = steady[i, w] + decay[i, w] * exp(-rate * at)
            if stops and after[0, i, w] <= at:
                v = steadies[0, i, w] + decays[0, i, w] * exp(-rate * (at - after[0, i, w]))
            after[row, i, w] = acts[i, w]
            steadies[row, i, w], decays[row, i, w] = motion_of(v, volts[i, w], law)
            stopped_s = acts[i, w] + stop_s(v, steadies[row, i, w], tau, law[2])
            stopped = stopped_s < span
            stops_after = stops_after or stopped
            after[row + 1, i, w] = stopped_s if stopped else inf
            steadies[row + 1, i, w], decays[row + 1, i, w] = motion_of(0.0, volts[i, w], law)
    return row + 2 if stops_after else row + 1


@kernel
def speed_after(steady, decay, rate, changes, at, i, w):
    """Return the speed of a wheel at an instant, m/s; see ``pass_changes``."""
    after, steadies, decays = changes
    speed = steady[i, w] + decay[i, w] * exp(-rate * at)
    for c in range(after.shape[0]):
        if after[c, i, w] <= at:
            speed = steadies[c, i, w] + decays[c, i, w] * exp(-rate * (at - after[c, i, w]))
    return speed


@kernel
def travel_of(steady, decay, rate, span):
    """Way of a wheel within a span, m."""
    return steady * span - decay * (expm1(-rate * span) / rate)


@kernel
def travel_after(steady, decay, rate, changes, at, i, w):
    """Return the way of a wheel until an instant, m; see ``pass_changes``."""
    after, steadies, decays = changes
    end = at
    for c in range(after.shape[0]):
        end = min(end, after[c, i, w])
    travel = travel_of(steady[i, w], decay[i, w], rate, end)
    for c in range(after.shape[0]):
        end = at
        for later in range(c + 1, after.shape[0]):
            end = min(end, after[later, i, w])
        span = max(end - after[c, i, w], 0.0)
        travel = travel + travel_of(steadies[c, i, w], decays[c, i, w], rate, span)
    return travel


@kernel
def pass_changes(steady, decay, rate, after, steadies, decays, reads, span, passed, travel, speed):
    """Take all wheels ``(n, 2)`` along a motion with changes.

    Args:
        steady: Steady part at the start, m/s.
        decay: Decaying part, m/s.
        rate: 1/s, not 0.
        after: ``(c, n, 2)`` times of changes, ascending, s; infinite where there is none.
        steadies: ``(c, n, 2)`` steady parts from then on, m/s.
        decays: ``(c, n, 2)`` decaying parts, m/s.
        reads: ``(n,)`` when each cell's encoders are read, s.
        span: s.
        passed: Way until then, m; is filled.
        travel: Way at the end, m; is filled.
        speed: Speed at the end, m/s; is filled.
    """
    changes = (after, steadies, decays)
    for i in range(steady.shape[0]):
        for w in range(2):
            passed[i, w] = travel_after(steady, decay, rate, changes, reads[i], i, w)
            travel[i, w] = travel_after(steady, decay, rate, changes, span, i, w)
            speed[i, w] = speed_after(steady, decay, rate, changes, span, i, w)


@kernel
def elapse(steady, decay, begun, span, covered, left, travel, speed):
    """Take all wheels ``(n, 2)`` along their motion.

    Args:
        steady: m/s.
        decay: m/s.
        begun: travel at the start, m.
        span: s.
        covered: s, by which the decaying part counts for travel.
        left: share of the decaying part at the end.
        travel: is filled with the travel at the end, m.
        speed: is filled with the speed at the end, m/s.
    """
    for i in range(steady.shape[0]):
        for w in range(2):
            travel[i, w] = begun[i, w] + steady[i, w] * span + decay[i, w] * covered
            speed[i, w] = steady[i, w] + decay[i, w] * left


@kernel
def exp_of_each(x, found):
    """Fill ``found`` with the exponentials of ``x``, ``(n,)`` each."""
    for i in range(len(x)):
        found[i] = exp(x[i])
