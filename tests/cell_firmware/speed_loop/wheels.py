"""Motors for speed loops to close on, solved exactly and apart from the plant's."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from cell_firmware.build import MotorFacts, wheels_of
from cell_firmware.components import WheelDriver
from cell_firmware.effects.registry import CellEffects
from cell_firmware.firmware import Cells
from cell_firmware.specs import CellsSpec, SpeedLoopSpec

PERIOD_S = 0.004096
GAIN = 0.1  # m/s per volt
TAU_S = 0.06
SUPPLY_V = 12.0
RADIUS_M = 0.03
TURN_M = math.tau * RADIUS_M
MOTORS = MotorFacts(SUPPLY_V, SUPPLY_V * GAIN)


def cells(n: int) -> Cells:
    return Cells.of(Lattice((0, i) for i in range(n)), np.zeros((n, 2)), PERIOD_S)


def drive(
    gains: SpeedLoopSpec | None = None, motors: MotorFacts = MOTORS, **effects: dict[str, object]
) -> WheelDriver:
    """The part that a scene with these effects gets."""
    part = wheels_of(CellsSpec(speed_loop=gains), CellEffects.model_validate(effects), motors)
    assert part is not None
    return part


class Wheel:
    """A first-order motor with Coulomb and static friction, in volts, under constant voltage: closed form.

    ``dV/dt = (gain (u - sign(V) coulomb) - V) / tau`` while it turns; it stops where V reaches 0, and starts again
    where ``|u| > static``.
    """

    def __init__(self, coulomb_v: float = 0.0, static_v: float = 0.0, speed: float = 0.0) -> None:
        self.coulomb_v, self.static_v = coulomb_v, static_v
        self.speed = speed
        self.travel = 0.0

    def advance(self, volts: float) -> None:
        left = PERIOD_S
        while left > 0.0:
            direction = self.speed or (volts if abs(volts) > self.static_v else 0.0)
            if direction == 0.0:
                return
            target = GAIN * (volts - math.copysign(self.coulomb_v, direction))
            span = left
            if self.speed * target < 0.0:
                span = min(left, TAU_S * math.log(1.0 - self.speed / target))
            decay = math.exp(-span / TAU_S)
            self.travel += target * span + (self.speed - target) * TAU_S * (1.0 - decay)
            self.speed = 0.0 if span < left else target + (self.speed - target) * decay
            left -= span


def follow(
    part: WheelDriver, references: Iterable[float], wheel: Wheel
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Speeds at the beginning of each period and voltages in it, ``(ticks,)``, of a wheel under a loop."""
    state = part.init(cells(1))
    speeds: list[float] = []
    volts: list[float] = []
    for reference in references:
        speeds.append(wheel.speed)
        state, out = part.step(state, np.array([[reference, 0.0]]), np.array([[wheel.travel, 0.0]]))
        volts.append(float(out[0, 0]))
        wheel.advance(volts[-1])
    return np.array(speeds), np.array(volts)
