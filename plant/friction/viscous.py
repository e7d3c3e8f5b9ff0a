"""Viscous traction (eq. 14): ``f = mu N (V - v)`` per wheel."""

from __future__ import annotations

import math
from typing import Literal, final

from bus.spec import Positive
from plant.errors import PlantError
from plant.friction.law import FrictionLaw, Traction


@final
class Viscous(FrictionLaw):
    """Traction in proportion to load and slip velocity: the paper's main model, eq. 14.

    Dissipation potential ``mu N |r|^2 / 2`` of the slip r: quadratic, so motion between events is analytic.
    """

    law: Literal["viscous"] = "viscous"
    coefficient_s_per_m: Positive
    """Viscous coefficient (eq. 14): traction per newton of load and per m/s of slip."""

    def traction(self) -> Traction:
        """``b = mu N``, without a limit."""
        return Traction(stiffness_per_load=self.coefficient_s_per_m, limit=math.inf)

    def rate(self, gravity_m_s2: float) -> float:
        """``mu g``, 1/s: the rate at which slip decays on a level surface, whatever the mass."""
        return self.coefficient_s_per_m * gravity_m_s2


def viscous_of(law: FrictionLaw, what: str) -> Viscous:
    """A scene's law, for what is defined for the viscous one alone.

    Raises:
        PlantError: it is another; ``what`` names the request.
    """
    if not isinstance(law, Viscous):
        name = law.model_dump()["law"]
        raise PlantError(f'friction.law = "{name}": there are {what} for the law viscous only')
    return law
