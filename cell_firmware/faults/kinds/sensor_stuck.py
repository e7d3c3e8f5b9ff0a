"""Fault ``sensor_stuck``: presence sensors with a constant reading."""

from __future__ import annotations

from typing import ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultInstance
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.sensors import AffectedSensors, SensorFault, SensorFilter
from cell_firmware.firmware import Floats


@final
class SensorStuckFault(SensorFault):
    """Sensors are stuck at 0 or 1; an analogue sensor reads fully uncovered or fully covered."""

    kind_name: ClassVar[str] = "sensor_stuck"
    kind: Literal["sensor_stuck"] = "sensor_stuck"
    value: Literal[0, 1]
    """The constant reading."""

    def make_filter(self, affected: AffectedSensors, injected: FaultInstance[CellFault]) -> SensorFilter:
        """Return a filter with a constant reading."""
        return _Stuck(bool(self.value), affected, injected)


@final
class _Stuck(SensorFilter):
    def __init__(self, value: bool, affected: AffectedSensors, injected: FaultInstance[CellFault]) -> None:
        super().__init__(affected, injected)
        self._value = value

    def override(self, tick: int, bit: NDArray[np.bool_], level: Floats | None) -> tuple[bool, float]:
        """Return the constant reading."""
        del tick, bit, level
        return self._value, float(self._value)
