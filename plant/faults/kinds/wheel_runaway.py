"""A wheel runs away: its output stage is stuck, whatever the drive."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, ClassVar, Literal, Self, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import Problem
from bus.spec import Positive
from plant.faults.base import WheelFault, WheelFaults

if TYPE_CHECKING:
    from plant.effects.motors import MotorsSpec
    from plant.effects.registry import PlantEffects


@final
class WheelRunawayFault(WheelFault):
    """Wheels run at the full supply voltage. Without motors they run at ``speed_m_s``."""

    kind_name: ClassVar[str] = "wheel_runaway"
    kind: Literal["wheel_runaway"]
    way: Literal["positive", "negative"] = "positive"
    """Direction: towards greater or smaller coordinates."""
    speed_m_s: Positive | None = None
    """Speed of ideal wheels; only for scenes without motors."""

    def setting_problems(self, effects: PlantEffects) -> Iterator[Problem]:
        """A speed is for ideal wheels, which have no supply."""
        if effects.motors is None and self.speed_m_s is None:
            yield ("kind",), self.kind, "needs speed_m_s: without effects.motors there is no supply to run at"
        elif effects.motors is not None and self.speed_m_s is not None:
            rule = "is for ideal wheels: with effects.motors a wheel runs at the full supply voltage; leave it out"
            yield ("speed_m_s",), self.speed_m_s, rule

    def on_ideal_wheels(self, motors: MotorsSpec) -> Self:
        """At the speed that the supply gives without load."""
        motor = motors.first_order
        volts = max(motors.supply_v - motor.coulomb_v, 0.0)
        return self.model_copy(update={"speed_m_s": volts * motor.speed_per_volt_m_s})

    def apply(self, cells: NDArray[np.int64], wheel_faults: WheelFaults) -> None:
        """Drives aren't heeded; of several that run away with a wheel the scene's last does."""
        speed_m_s = np.inf if self.speed_m_s is None else self.speed_m_s
        wheel_faults.runs_m_s[self.wheels(cells)] = speed_m_s if self.way == "positive" else -speed_m_s
