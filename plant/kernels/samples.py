"""Others' wishes on the way of a call: states at instants, and its early end."""

from __future__ import annotations

from plant.kernels import layout as at
from plant.kernels.jit import kernel


@kernel
def may_go_on(stop, taken, steps, now):
    """Status before another step: whether somebody asks for the call's end, or too many steps led no farther.

    Args:
        stop: ``(1,)``: see ``plant.stop``.
        taken: steps of this call so far.
        steps: ``(2,)`` allowed: at once, and more for each second reached.
        now: s reached in this call.
    """
    if stop[0] != 0:
        return at.STOPPED
    return at.ENDLESS_STEPS if taken > steps[0] + steps[1] * now else at.MOVING


@kernel
def sampled_until(now, y, times, sampled, out):
    """Write ``y`` for the ``times`` up to ``now``, of which the first ``sampled`` are written. Returns how many are."""
    while sampled < times.shape[0] and times[sampled] <= now:
        for k in range(6):
            out[sampled, k] = y[k]
        sampled += 1
    return sampled


@kernel
def fill(y, times, sampled, out):
    """Write ``y``, where the motion ended, for all ``times`` after the first ``sampled``."""
    for i in range(sampled, times.shape[0]):
        for k in range(6):
            out[i, k] = y[k]
