"""Coulomb traction in full sliding (eq. 24): ``f = mu N sign(V)`` per wheel, whatever the parcel does."""

from __future__ import annotations

from typing import Literal, final

from bus.spec import Positive
from plant.friction.law import FrictionLaw, Traction


@final
class CoulombSliding(FrictionLaw):
    """The paper's eq. 24: every wheel is taken to outrun the parcel, so its force depends on its own direction only.

    Dissipation potential ``-mu N sign(V) r``: linear, so nothing damps. It holds only while no wheel is outrun by the
    parcel; the plant reports when one is (event ``outrun``). ``coulomb`` holds always.
    """

    law: Literal["coulomb_sliding"]
    coefficient: Positive
    """Coulomb coefficient: traction per newton of load, dimensionless."""

    def traction(self) -> Traction:
        """``g = mu N sign(V)`` alone."""
        return Traction(push_per_load=self.coefficient)
