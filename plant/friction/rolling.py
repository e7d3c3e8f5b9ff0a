"""Rolling without slip (eq. 27): ``f = f0 - b v`` per wheel, whatever the load."""

from __future__ import annotations

import math
from typing import Literal, final

from plant.friction.law import Traction
from plant.friction.motor import MotorLaw


@final
class Rolling(MotorLaw):
    """The wheels never slip: the motors' own slope is all that gives, eqs. 27-28.

    Dissipation potential ``b |f0/b - v|^2 / 2``. The sign of the rotation in the paper's eq. 28 is corrected: ``v`` is
    the underside's velocity above the cell, ``U + omega J (p - X)``. Which cells carry load matters, how much doesn't.
    """

    law: Literal["rolling"]

    def traction(self) -> Traction:
        """``b`` without a limit, about the free speed ``f0 / b``."""
        return Traction(stiffness=self.damping_n_s_per_m, limit=math.inf, free_speed=self.free_speed)
