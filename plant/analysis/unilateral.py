"""Loads on springs of unequal stiffness and height that push and never pull, in NumPy.

The problem is that of ``plant.kernels.common.loads``: the springs' plane ``z`` is where the energy
``sum k_i ((z . q_i - g_i)+)^2 / 2`` less the work of the weight is least. ``plant.loads`` has equal springs.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

_STEPS = 200
_HALVINGS = 60
_BALANCED = 1e-9
"""Share of the weight by which loads may miss the balance of forces and moments, lengths in pitches."""
_WEIGHT = np.array([1.0, 0.0, 0.0])


class _Springs(NamedTuple):
    """Springs under a parcel: ``[1, x, y]`` of each, ``(n, 3)``; stiffness and gap, ``(n,)`` each."""

    q: Floats
    stiffness: Floats
    gap: Floats

    def loads(self, z: Floats) -> Floats:
        return self.stiffness * np.maximum(self.q @ z - self.gap, 0.0)

    def slope(self, z: Floats) -> Floats:
        return self.q.T @ self.loads(z) - _WEIGHT

    def energy(self, z: Floats) -> float:
        return float(0.5 * self.loads(z) @ np.maximum(self.q @ z - self.gap, 0.0) - _WEIGHT @ z)

    def newton_step(self, z: Floats) -> Floats:
        on = self.loads(z) > 0.0
        hessian: Floats = self.q[on].T @ (self.stiffness[on, None] * self.q[on])
        # supports on a line leave it singular: a trace of ridge keeps the step finite
        ridge = 1e-13 * (1.0 + float(np.count_nonzero(on))) * np.eye(3)
        return np.asarray(np.linalg.solve(hessian + ridge, -self.slope(z)), dtype=np.float64)


def unilateral_loads(offsets: Floats, stiffness: Floats, gap: Floats) -> Floats | None:
    """Compute the loads under a parcel as shares of its weight.

    Args:
        offsets: Cells from the centre of mass, ``(n, 2)``, in pitches.
        stiffness: Stiffness of each cell over the mean one, ``(n,)``.
        gap: Distance by which each unloaded spring ends below the mean level, over the sag of one mean spring under
            the whole weight, ``(n,)``.

    Returns:
        Loads, ``(n,)``; None if no loads balance, which is where the parcel tips.
    """
    n = len(offsets)
    if n == 0:
        return None
    springs = _Springs(np.column_stack([np.ones(n), offsets]), stiffness, gap)
    z: Floats = np.array([1.0 / n + float(gap.max()), 0.0, 0.0])
    for _ in range(_STEPS):
        if float(np.abs(springs.slope(z)).sum()) <= 1e-14:
            break
        better = _line_search(springs, z, springs.newton_step(z))
        if better is None:
            break
        z = better
    load = springs.loads(z)
    return load if float(np.abs(springs.slope(z)).max()) <= _BALANCED else None


def _line_search(springs: _Springs, z: Floats, step: Floats) -> Floats | None:
    """Return the plane at the end of a step that lowers the energy; None if no step does."""
    value, descent, size = springs.energy(z), float(springs.slope(z) @ step), 1.0
    for _ in range(_HALVINGS):
        trial = z + size * step
        energy = springs.energy(trial)
        if energy <= value + 1e-4 * size * descent:
            return trial if energy < value else None
        size *= 0.5
    return None
