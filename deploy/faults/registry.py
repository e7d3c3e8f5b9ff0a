"""Registry of all fault kinds; a new kind is a module and a line here."""

from __future__ import annotations

import re
from typing import Annotated, Final, get_args

from pydantic import BeforeValidator, Field

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
from cell_firmware.faults.kinds.reboot import RebootFault
from cell_firmware.faults.kinds.sensor_delay import SensorDelayFault
from cell_firmware.faults.kinds.sensor_flip import SensorFlipFault
from cell_firmware.faults.kinds.sensor_stuck import SensorStuckFault
from cell_firmware.faults.kinds.slow_clock import SlowClockFault
from deploy.faults.crash import CrashFault
from deploy.faults.modules import AddFault, RemoveFault
from plant.faults.kinds.wheel_reversed import WheelReversedFault
from plant.faults.kinds.wheel_runaway import WheelRunawayFault
from plant.faults.kinds.wheel_stuck import WheelStuckFault
from plant.faults.kinds.wheel_weak import WheelWeakFault
from plant.tagged import tagged

AnyFault = (
    CrashFault  # the default
    | HangFault
    | RebootFault
    | SlowClockFault
    | RemoveFault
    | AddFault
    | WheelStuckFault
    | WheelWeakFault
    | WheelReversedFault
    | WheelRunawayFault
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

DEFAULT: Final = "crash"
"""Kind of a fault that does not say which."""

Fault = Annotated[Annotated[AnyFault, Field(discriminator="kind")], BeforeValidator(tagged("kind", DEFAULT))]
"""Any fault of a scene, discriminated by ``kind``."""

KINDS: dict[str, type[AnyFault]] = {kind.kind_name: kind for kind in get_args(AnyFault)}


def gist(kind: str) -> str:
    """Return a few words on a kind of fault: how its description begins."""
    first = (KINDS[kind].__doc__ or "").partition("\n")[0].replace("``", "").rstrip(".")
    return re.split(r"[.,:;] ", first, maxsplit=1)[0]
