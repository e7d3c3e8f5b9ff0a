"""Fault ``sensor_flip``: presence sensors with inverted readings at random."""

from __future__ import annotations

from typing import ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultInstance
from cell_firmware.effects.sensor import Probability
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.sensors import AffectedSensors, SensorFault, SensorFilter
from cell_firmware.firmware import Floats


@final
class SensorFlipFault(SensorFault):
    """Readings are inverted at random, each independently; an analogue level x becomes 1 - x."""

    kind_name: ClassVar[str] = "sensor_flip"
    kind: Literal["sensor_flip"] = "sensor_flip"
    rate: Probability
    """Probability of an inverted reading, for each sensor and tick."""

    def make_filter(self, affected: AffectedSensors, injected: FaultInstance[CellFault]) -> SensorFilter:
        """Flips."""
        return _Flip(self.rate, affected, injected)


@final
class _Flip(SensorFilter):
    def __init__(self, rate: float, affected: AffectedSensors, injected: FaultInstance[CellFault]) -> None:
        super().__init__(affected, injected)
        self._rate = rate
        self._draws = affected.draws(injected)

    def override(
        self, tick: int, bit: NDArray[np.bool_], level: Floats | None
    ) -> tuple[NDArray[np.bool_], Floats | None]:
        """The opposite, where chance has it."""
        wrong = (self._draws.uniform(tick) < self._rate).reshape(bit.shape)
        return bit ^ wrong, None if level is None else np.where(wrong, 1.0 - level, level)
