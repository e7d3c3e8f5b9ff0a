"""Registry of the faults that a control record can begin in a shard during the run."""

from __future__ import annotations

from typing import Annotated, Any, Final

from pydantic import ConfigDict, Field, TypeAdapter

from cell_firmware.faults.kinds.babble import BabbleFault
from cell_firmware.faults.kinds.hang import HangFault
from cell_firmware.faults.kinds.lie import LieFault
from cell_firmware.faults.kinds.link_bandwidth import LinkBandwidthFault
from cell_firmware.faults.kinds.link_corrupt import LinkCorruptFault
from cell_firmware.faults.kinds.link_delay import LinkDelayFault
from cell_firmware.faults.kinds.link_down import LinkDownFault
from cell_firmware.faults.kinds.link_duplicate import LinkDuplicateFault
from cell_firmware.faults.kinds.link_loss import LinkLossFault
from cell_firmware.faults.kinds.link_reorder import LinkReorderFault
from cell_firmware.faults.kinds.partition import PartitionFault
from cell_firmware.faults.kinds.power_loss import CrashedCellFault, RemovedCellFault
from cell_firmware.faults.kinds.reboot import RebootFault
from cell_firmware.faults.kinds.sensor_delay import SensorDelayFault
from cell_firmware.faults.kinds.sensor_flip import SensorFlipFault
from cell_firmware.faults.kinds.sensor_stuck import SensorStuckFault
from cell_firmware.faults.kinds.slow_clock import SlowClockFault

CellOnlyFault = (
    HangFault
    | RebootFault
    | SlowClockFault
    | SensorStuckFault
    | SensorFlipFault
    | SensorDelayFault
    | LinkDownFault
    | LinkLossFault
    | LinkDelayFault
    | LinkDuplicateFault
    | LinkReorderFault
    | LinkCorruptFault
    | LinkBandwidthFault
    | BabbleFault
    | LieFault
    | PartitionFault
)
"""Kinds that act in cells alone; a new one is a module and a line here."""

AnyCellFault = CrashedCellFault | RemovedCellFault | CellOnlyFault

CELL_FAULTS: Final[TypeAdapter[Any]] = TypeAdapter(
    Annotated[AnyCellFault, Field(discriminator="kind")], config=ConfigDict(defer_build=True)
)
