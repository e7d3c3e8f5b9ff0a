"""Coulomb traction, set-valued: up to ``mu N`` while nothing slips, all of it against the slip else."""

from __future__ import annotations

from typing import Literal, final

from pydantic import model_validator

from bus.spec import NotNegative, Positive
from plant.friction.law import FrictionLaw, Traction


@final
class Coulomb(FrictionLaw):
    """``f = mu N Sgn(r)``: any force in ``[-mu N, mu N]`` where a wheel sticks, ``mu N`` along the slip where it slips.

    Dissipation potential ``mu N |r|``, of each axis (a box per cell) or of the slip's magnitude (a circular cone).
    The two differ in kind: driven along a diagonal, two independent wheels pull with the square root of 2 times as
    much, and one that slips leaves the other its whole grip.

    With ``viscous_n_s_per_m`` b the force at a slipping wheel is ``mu N sign(r) + b r``, and the potential has
    ``b |r|^2 / 2`` beside it.
    """

    law: Literal["coulomb"]
    coefficient: Positive
    """Coulomb coefficient: largest traction per newton of load, dimensionless."""
    contact: Literal["independent_wheels", "isotropic"] = "independent_wheels"
    """Friction cone: each wheel of a cell slips independently, or both wheels share a circular cone."""
    static_coefficient: Positive | None = None
    """Coefficient of a wheel that sticks, at least ``coefficient``, which is then that of a wheel that slips. Default:
    ``coefficient``."""
    viscous_n_s_per_m: NotNegative = 0.0
    """Viscous part of a wheel's traction, per m/s of slip, in addition to the Coulomb part and whatever the load."""

    @model_validator(mode="after")
    def _holds_as_it_drags(self) -> Coulomb:
        static = self.static_coefficient
        if static is not None and static < self.coefficient:
            rule = f"static_coefficient = {static:g} must be at least coefficient = {self.coefficient:g}"
            raise ValueError(rule)
        return self

    @property
    def solvers(self) -> tuple[str, ...] | None:
        """``implicit`` alone remembers which wheels stick."""
        return None if self.static_coefficient is None else ("implicit",)

    def traction(self) -> Traction:
        """``b`` infinite, ``c = mu N``."""
        return Traction(
            limit_per_load=self.coefficient,
            viscous=self.viscous_n_s_per_m,
            set_valued=True,
            static_ratio=(self.static_coefficient or self.coefficient) / self.coefficient,
            isotropic=self.contact == "isotropic",
        )
