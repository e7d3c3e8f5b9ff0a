"""What a geared DC motor comes to at the wheel's surface (eqs. 25-27; the coil's inductance neglected).

With gears of ratio g and a wheel of radius r the rotor turns at g V / r, so that at the surface

    torque constant k -> K = k g / r, N/A and V s/m      damping d -> B = d (g / r)^2, N s/m
    inertia J         -> m = (J_rotor g^2 + J_wheel) / r^2, kg

and ``m dV/dt = K u / R - (B + K^2 / R) V - F sign V``: a stalled wheel gives ``f0 = K / R`` newtons a volt and a moving
one ``b = B + K^2 / R`` less for every m/s, so that it lags by ``m / b`` behind ``f0 / b`` m/s a volt.
"""

from __future__ import annotations

from typing import Self, final

from pydantic import model_validator

from bus.spec import NotNegative, Positive, Spec


@final
class DcMotorSpec(Spec):
    """A DC motor with gears and a wheel, as its data sheet and a scale have it."""

    gear_ratio: Positive = 1.0
    """Turns of the rotor to one of the wheel."""
    rotor_inertia_kg_m2: Positive
    wheel_inertia_kg_m2: NotNegative = 0.0
    """Of the wheel and what turns with it, about its shaft."""
    wheel_radius_m: Positive
    damping_n_m_s: NotNegative = 0.0
    """Viscous torque at the rotor per rad/s."""
    resistance_ohm: Positive
    torque_constant_n_m_per_a: Positive
    """At the rotor; as many V s/rad."""
    coulomb_torque_n_m: NotNegative = 0.0
    """Dry friction at the wheel's shaft while it turns, ..."""
    static_torque_n_m: NotNegative | None = None
    """... and what it takes to start it; None: the same."""

    @model_validator(mode="after")
    def _starts_no_easier(self) -> Self:
        if self.static_torque_n_m is not None and self.static_torque_n_m < self.coulomb_torque_n_m:
            raise ValueError(
                f"static_torque_n_m = {self.static_torque_n_m:g}: must be at least coulomb_torque_n_m, "
                f"{self.coulomb_torque_n_m:g}"
            )
        return self

    @property
    def inertia_kg(self) -> float:
        """``m``: of rotor, gears and wheel, as the surface feels it."""
        geared = self.rotor_inertia_kg_m2 * self.gear_ratio**2
        return (geared + self.wheel_inertia_kg_m2) / self.wheel_radius_m**2

    @property
    def stall_force_n_per_v(self) -> float:
        """``f0`` per volt: what a wheel that stands gives at its surface, eq. 25."""
        per_ampere = self.torque_constant_n_m_per_a * self.gear_ratio / self.wheel_radius_m
        return per_ampere / self.resistance_ohm

    @property
    def damping_n_s_per_m(self) -> float:
        """``b``: how much less a wheel gives per m/s of surface speed, eq. 26 without a speed controller."""
        leverage = self.gear_ratio / self.wheel_radius_m
        per_ampere = self.torque_constant_n_m_per_a * leverage
        return self.damping_n_m_s * leverage**2 + per_ampere**2 / self.resistance_ohm

    @property
    def time_constant_s(self) -> float:
        """``m / b``."""
        return self.inertia_kg / self.damping_n_s_per_m

    @property
    def speed_per_volt_m_s(self) -> float:
        """``f0 / b``: surface speed per volt without load."""
        return self.stall_force_n_per_v / self.damping_n_s_per_m

    @property
    def coulomb_v(self) -> float:
        """Voltage that dry friction takes from a turning wheel."""
        return self.coulomb_torque_n_m / self.wheel_radius_m / self.stall_force_n_per_v

    @property
    def static_v(self) -> float:
        """Voltage beyond which a wheel that stands starts."""
        torque = self.coulomb_torque_n_m if self.static_torque_n_m is None else self.static_torque_n_m
        return torque / self.wheel_radius_m / self.stall_force_n_per_v
