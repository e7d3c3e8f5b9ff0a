"""Stick-slip: rolls until traction runs out, ``f = clamp(f0 - b v, -mu N, +mu N)`` per wheel."""

from __future__ import annotations

from typing import Literal, final

from bus.spec import Positive
from plant.friction.law import Traction
from plant.friction.motor import MotorLaw


@final
class StickSlip(MotorLaw):
    """The mixed mode of Luntz et al., ACC 1998: motors as in ``rolling``, traction as in ``coulomb``.

    Dissipation potential: Huber's, a parabola up to ``mu N``, a straight line beyond.
    """

    law: Literal["stick_slip"]
    coefficient: Positive
    """Coulomb coefficient: largest traction per newton of load, dimensionless."""

    def traction(self) -> Traction:
        """``b`` about the free speed, ``c = mu N``."""
        return Traction(
            stiffness=self.damping_n_s_per_m, limit_per_load=self.coefficient, free_speed=self.free_speed
        )
