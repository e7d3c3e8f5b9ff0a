"""Effect ``wheel_load``: what a wheel pulls slows its motor, ``m (dV/dt + (V - V_ss) / tau) = -f``.

``V_ss`` and tau are those of the effect ``motors``, m the inertia of wheel, gears and rotor as the surface feels it, f
the wheel's force on the parcel. Stalled, a motor gives ``m V_ss / tau``.
"""

from __future__ import annotations

from typing import ClassVar, Self, final

from bus.effect import EffectSpec
from bus.spec import Positive


@final
class WheelLoadSpec(EffectSpec):
    """Wheels with inertia, slowed by traction."""

    solvers: ClassVar[tuple[str, ...] | None] = ("implicit",)
    needs: ClassVar[tuple[str, ...]] = ("motors",)
    states: ClassVar[tuple[str, ...]] = ("what its load took from every wheel's speed and travel",)
    fidelity_rank: ClassVar[int | None] = 40
    inertia_kg: Positive | None = None
    """Inertia of a wheel with its drive train at the surface: moment of inertia over the wheel's radius squared. None:
    from ``motors.dc``."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """50 g."""
        return cls(inertia_kg=0.05)
