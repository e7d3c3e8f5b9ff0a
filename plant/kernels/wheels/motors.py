"""First-order motors of all wheels, in one pass over them: see ``plant.effects.motors``.

Only arithmetic that has the same bits everywhere. Exponentials and logarithms are NumPy's, whose last bits are not
those of compiled code.
"""

from __future__ import annotations

from math import exp, expm1, inf, log1p

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


@kernel
def expm1_of_each(x, found):
    """Fill ``found`` with ``exp(x) - 1``, ``(n,)`` each."""
    for i in range(len(x)):
        found[i] = expm1(x[i])
