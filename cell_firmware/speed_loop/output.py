"""Pulse-width modulation: voltages in whole counts of a timer."""

from __future__ import annotations

from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.errors import FirmwareError
from cell_firmware.firmware import Floats


def share(kp: float, ki_t: float, feed_forward: float) -> float:
    """By how much of its way the integral moves each saturated period, 0 to 1; 0 without an integral.

    Args:
        kp: Proportional gain, >= 0.
        ki_t: Integral gain times the period, >= 0, in the same unit.
        feed_forward: Likewise.
    """
    return ki_t / (kp + feed_forward + ki_t) if ki_t else 0.0


Duties = NDArray[np.int32]

MOST_LEVELS: Final = 2**16 - 1
"""Of a 16-bit timer."""


@final
class Pwm:
    """Sign and magnitude: a sign, and for how many of a period's counts the supply is on.

    What acts on the motor is the mean, ``supply duty / levels``; the ripple within a pulse period is neglected.

    Args:
        levels: Timer counts of a pulse period, 1 to 65,535.
        supply_v: Voltage of a pulse, V.
    """

    def __init__(self, levels: int, supply_v: float) -> None:
        if not 1 <= levels <= MOST_LEVELS:
            raise FirmwareError(f"pwm: levels must be 1 to {MOST_LEVELS}, not {levels}")
        self.levels = levels
        self.supply_v = supply_v

    def duty(self, volts: Floats) -> Duties:
        """Whole counts, negative for reverse; magnitudes rounded to the nearest, ties up.

        Args:
            volts: Within the supply.
        """
        counts = np.floor(np.abs(volts) * (self.levels / self.supply_v) + 0.5)
        return np.where(volts < 0.0, -counts, counts).astype(np.int32)

    def volts(self, duty: Duties) -> Floats:
        """The mean voltage of a duty."""
        return duty * self.supply_v / self.levels
