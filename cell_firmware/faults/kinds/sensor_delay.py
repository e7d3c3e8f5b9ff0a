"""Fault ``sensor_delay``: presence sensors whose readings come late."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from bus.fault import FaultInstance
from bus.state import StateFields
from cell_firmware.effects.sensor import LONGEST_TICKS
from cell_firmware.faults.base import CellFault
from cell_firmware.faults.sensors import AffectedSensors, SensorFault, SensorFilter
from cell_firmware.firmware import Floats, Inputs


@final
class SensorDelayFault(SensorFault):
    """Sensors lag by ``ticks`` readings. Until so many readings exist, the first is repeated."""

    kind_name: ClassVar[str] = "sensor_delay"
    kind: Literal["sensor_delay"] = "sensor_delay"
    ticks: Annotated[int, Field(ge=1, le=LONGEST_TICKS)]

    def make_filter(self, affected: AffectedSensors, injected: FaultInstance[CellFault]) -> SensorFilter:
        """Return a filter that delays readings."""
        return _Delay(self.ticks, affected, injected)


@final
class _Delay(SensorFilter):
    """Filter that records readings from ``ticks`` before the fault's start, and delays readings."""

    state_fields: ClassVar[StateFields] = StateFields("_begun", "_bits", "_levels")

    def __init__(self, ticks: int, affected: AffectedSensors, injected: FaultInstance[CellFault]) -> None:
        super().__init__(affected, injected)
        self._ticks = ticks
        self._begun = False
        self._bits = np.zeros((ticks, *affected.shape), dtype=np.bool_)
        self._levels = np.zeros((ticks, *affected.shape))

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Filter the inputs while the fault is active; record readings before its start."""
        if self._injected.start_tick - self._ticks <= tick < self._injected.start_tick:
            at = self._affected.at
            self.override(tick, inputs.presence[at], None if inputs.level is None else inputs.level[at])
        return super().apply(tick, inputs, alive)

    def override(
        self, tick: int, bit: NDArray[np.bool_], level: Floats | None
    ) -> tuple[NDArray[np.bool_], Floats | None]:
        """Return the readings of ``ticks`` ago, and record the current ones."""
        if not self._begun:
            self._begun = True
            self._bits[:] = bit
            self._levels[:] = 0.0 if level is None else level
        slot = tick % self._ticks
        then = self._bits[slot].copy(), self._levels[slot].copy()
        self._bits[slot] = bit
        if level is None:
            return then[0], None
        self._levels[slot] = level
        return then
