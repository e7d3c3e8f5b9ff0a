"""The wheel's motor under a proportional speed controller (eqs. 25-27), which several laws contain."""

from __future__ import annotations

from bus.spec import NotNegative, Positive
from plant.friction.law import FrictionLaw


class MotorLaw(FrictionLaw):
    """A law whose wheels roll: the motor's force on the surface is ``f0 - b v``.

    With the voltage ``u = G (ref - v)``, ``ref`` being the commanded surface speed, the force
    ``K u / R - (B + K^2/R) v`` gives ``f0 = K G ref / R`` and ``b = B + K^2/R + K G/R``. All along the surface, gears
    and wheel radius included.
    """

    motor_constant_n_per_a: Positive
    """K: force at the surface per ampere, and volts per m/s of surface speed."""
    resistance_ohm: Positive
    """R: resistance of the winding."""
    gain_v_s_per_m: Positive
    """G: gain of the speed controller, volts per m/s of error."""
    drag_n_s_per_m: NotNegative = 0.0
    """B: drag of bearings and gears per m/s."""

    @property
    def damping_n_s_per_m(self) -> float:
        """``b``, N s/m."""
        k, r = self.motor_constant_n_per_a, self.resistance_ohm
        return self.drag_n_s_per_m + k * k / r + k * self.gain_v_s_per_m / r

    @property
    def free_speed(self) -> float:
        """``f0 / (b ref)``: the share of the commanded speed at which a wheel without load runs."""
        return (
            self.motor_constant_n_per_a * self.gain_v_s_per_m / self.resistance_ohm / self.damping_n_s_per_m
        )

    @property
    def own_motors(self) -> bool:
        """Its motors are in the law."""
        return True
