"""What is known of the damped oscillator that a centre of mass is in a linear field: damping, overshoot, period."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np


@final
@dataclass(frozen=True, slots=True)
class Oscillator:
    """``x'' = kappa (k x - x')`` from rest, k < 0, underdamped: eqs. 16-18 in a field ``V = k x``.

    Attributes:
        kappa: ``mu g``, 1/s.
        k: the field's rate along the axis, 1/s.
    """

    kappa: float
    k: float

    @property
    def natural_rad_s(self) -> float:
        """``sqrt(mu g |k|)``."""
        return float(np.sqrt(self.kappa * abs(self.k)))

    @property
    def damping(self) -> float:
        """``sqrt(mu g / |k|) / 2``; below 1 it swings."""
        return 0.5 * float(np.sqrt(self.kappa / abs(self.k)))

    @property
    def swing_rad_s(self) -> float:
        """At which it swings, damping included."""
        return self.natural_rad_s * float(np.sqrt(1.0 - self.damping**2))

    @property
    def overshoot(self) -> float:
        """How far it first swings to the other side, over where it began."""
        return float(np.exp(-np.pi * self.damping / np.sqrt(1.0 - self.damping**2)))

    @property
    def overshoot_s(self) -> float:
        """When it is there: half a period."""
        return float(np.pi / self.swing_rad_s)
