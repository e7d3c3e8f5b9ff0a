"""Wheels around which there are faults: jammed, weak, reversed, run away, or gone with their cell."""

from __future__ import annotations

from typing import TYPE_CHECKING, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant.faults.base import WheelFaults
from plant.wheels import Floats, WheelChanges, WheelMotion, WheelRun, Wheels

if TYPE_CHECKING:
    from plant.effects.motors import MotorsSpec


@final
class FaultyWheels:
    """Wheels whose drives pass through active faults; jammed wheels and wheels of removed cells stand.

    A fault acts at once, on the present drive as on later drives. With motors, a fault changes the voltage at the
    wheels, which continue from their present speed.

    Args:
        wheels: Wheels without faults.
        motors: Motors of the scene; None where wheels are ideal. Drives are m/s without motors, else volts.
        cells: Number of cells in the array.
    """

    state_fields: ClassVar[StateFields] = StateFields("_wheels")

    def __init__(self, wheels: Wheels, motors: MotorsSpec | None, cells: int) -> None:
        self._wheels = wheels
        self._motors = motors
        self._wheel_faults = WheelFaults.healthy(cells)
        self._still: NDArray[np.bool_] = np.zeros((cells, 2), dtype=np.bool_)

    def apply_faults(self, wheel_faults: WheelFaults, drives: Floats) -> None:
        """Something else is the matter from now on, while ``drives`` ``(n, 2)`` go on until others take effect."""
        self._wheel_faults = wheel_faults
        self._still = wheel_faults.stuck | wheel_faults.gone[:, None]
        self._wheels.command(self._acting(drives), 0.0)

    def command(self, drives: Floats, span_s: float, acts_s: Floats | None = None) -> WheelRun:
        """Apply drives for ``span_s`` seconds; see ``plant.wheels.Wheels``."""
        run = self._wheels.command(self._acting(drives), span_s, acts_s)
        return _with_locked(run, self._still) if self._still.any() else run

    def elapse(self, run: WheelRun, span_s: float, reads_s: Floats | None = None) -> Floats | None:
        """Let the wheels turn; see ``plant.wheels.Wheels``."""
        return self._wheels.elapse(run, span_s, reads_s)

    @property
    def speed(self) -> Floats:
        """``(n, 2)`` m/s, now."""
        return np.where(self._still, 0.0, self._wheels.speed)

    @property
    def travel(self) -> Floats | None:
        """``(n, 2)`` m of surface passed since the start; None without encoders."""
        return self._wheels.travel

    def _acting(self, drives: Floats) -> Floats:
        """Return ``drives`` as the wheels receive them: m/s, or volts within the supply's limits."""
        wheel_faults, supply, most = self._wheel_faults, np.inf, speed_limit(self._wheel_faults, self._motors)
        if self._motors is not None:
            supply = self._motors.supply_v
        commanded = np.where(np.isnan(wheel_faults.runs_m_s), drives, wheel_faults.runs_m_s)
        return np.clip(np.clip(commanded, -supply, supply) * wheel_faults.factor, -most, most)


def speed_limit(wheel_faults: WheelFaults, motors: MotorsSpec | None) -> Floats:
    """The greatest drive ``(n, 2)`` that faults let through: a speed, or the voltage that leads to it without load."""
    if motors is None:
        return wheel_faults.most_m_s
    motor = motors.first_order
    return wheel_faults.most_m_s / motor.speed_per_volt_m_s + motor.coulomb_v


def _with_locked(run: WheelRun, still: NDArray[np.bool_]) -> WheelRun:
    """Return a copy of the motion in which the wheels of ``still`` stand from start to end."""
    motion, changes = run.motion, run.changes
    halted = WheelMotion(
        np.where(still, 0.0, motion.steady), np.where(still, 0.0, motion.decay), motion.rate, motion.slowing
    )
    if changes is None:
        return WheelRun(halted)
    after_s = np.where(still, np.inf, changes.after_s)
    steady, decay = (np.where(still, 0.0, part) for part in changes[1:])
    return WheelRun(halted, WheelChanges(after_s, steady, decay))
