"""Traction laws with the parameters that tests use, by name."""

from __future__ import annotations

from plant.friction.coulomb import Coulomb
from plant.friction.coulomb_sliding import CoulombSliding
from plant.friction.registry import FrictionSpec
from plant.friction.rolling import Rolling
from plant.friction.stick_slip import StickSlip
from plant.friction.viscous import Viscous

MU = 0.3
"""Coulomb's coefficient."""
MOTORS = {"motor_constant_n_per_a": 2.0, "resistance_ohm": 4.0, "gain_v_s_per_m": 10.0, "drag_n_s_per_m": 0.5}
B = 0.5 + 2.0 * 2.0 / 4.0 + 2.0 * 10.0 / 4.0
"""Resistance of such a motor to slip, N s/m."""
FREE = 2.0 * 10.0 / 4.0 / B
"""Share of the commanded speed at which such a wheel runs free."""
VISCOUS = Viscous(coefficient_s_per_m=0.2)
COULOMB = Coulomb(law="coulomb", coefficient=MU)
CONE = Coulomb(law="coulomb", coefficient=MU, contact="isotropic")
DAMPED = Coulomb(law="coulomb", coefficient=MU, viscous_n_s_per_m=0.7)
"""Coulomb with viscous friction."""
DAMPED_CONE = Coulomb(law="coulomb", coefficient=MU, contact="isotropic", viscous_n_s_per_m=0.7)
SLIDING = CoulombSliding(law="coulomb_sliding", coefficient=MU)
ROLLING = Rolling(law="rolling", **MOTORS)
STICK_SLIP = StickSlip(law="stick_slip", coefficient=MU, **MOTORS)
STATIC = Coulomb(law="coulomb", coefficient=MU, static_coefficient=0.45)
STATIC_CONE = Coulomb(law="coulomb", coefficient=MU, static_coefficient=0.45, contact="isotropic")
STATIC_LAWS: dict[str, FrictionSpec] = {"static": STATIC, "static_cone": STATIC_CONE}
"""Laws that have kernels of their own."""
LAWS: dict[str, FrictionSpec] = {
    "viscous": VISCOUS,
    "coulomb": COULOMB,
    "cone": CONE,
    "damped": DAMPED,
    "damped_cone": DAMPED_CONE,
    "sliding": SLIDING,
    "rolling": ROLLING,
    "stick_slip": STICK_SLIP,
}
