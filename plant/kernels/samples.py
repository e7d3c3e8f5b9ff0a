"""States that are asked for on the way."""

from __future__ import annotations

from plant.kernels.jit import kernel


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
