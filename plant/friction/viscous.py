"""Viscous traction (eq. 14): ``f = mu N (V - v)`` per wheel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

from plant.specs import FrictionSpec


@final
@dataclass(frozen=True, slots=True)
class Viscous:
    """Traction in proportion to load and slip velocity: the paper's main model, eq. 14.

    Dissipation potential ``mu N |r|^2 / 2`` of the slip r: quadratic, so motion between events is analytic.

    Args:
        coefficient_s_per_m: mu, traction per newton of load and per m/s of slip, > 0.
    """

    coefficient_s_per_m: float

    @classmethod
    def from_spec(cls, spec: FrictionSpec) -> Viscous:
        """The law a scene asks for."""
        return cls(spec.coefficient_s_per_m)

    def rate(self, gravity_m_s2: float) -> float:
        """``mu g``, 1/s: the rate at which slip decays on a level surface, whatever the mass."""
        return self.coefficient_s_per_m * gravity_m_s2
