"""Every fault that a scene may schedule: a new one is a file and a line here."""

from __future__ import annotations

import re
from typing import Annotated, get_args

from pydantic import BeforeValidator, Field

from cell_firmware.faults.babble import BabbleFault
from cell_firmware.faults.hang import HangFault
from cell_firmware.faults.lie import LieFault
from cell_firmware.faults.link_bandwidth import LinkBandwidthFault
from cell_firmware.faults.link_corrupt import LinkCorruptFault
from cell_firmware.faults.link_delay import LinkDelayFault
from cell_firmware.faults.link_down import LinkDownFault
from cell_firmware.faults.link_duplicate import LinkDuplicateFault
from cell_firmware.faults.link_loss import LinkLossFault
from cell_firmware.faults.link_reorder import LinkReorderFault
from cell_firmware.faults.partition import PartitionFault
from cell_firmware.faults.reboot import RebootFault
from cell_firmware.faults.sensor_delay import SensorDelayFault
from cell_firmware.faults.sensor_flip import SensorFlipFault
from cell_firmware.faults.sensor_stuck import SensorStuckFault
from cell_firmware.faults.slow_clock import SlowClockFault
from deploy.faults.add import AddFault
from deploy.faults.crash import CrashFault
from deploy.faults.remove import RemoveFault
from plant.faults.wheel_reversed import WheelReversedFault
from plant.faults.wheel_runaway import WheelRunawayFault
from plant.faults.wheel_stuck import WheelStuckFault
from plant.faults.wheel_weak import WheelWeakFault
from plant.spec import tagged

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

Fault = Annotated[Annotated[AnyFault, Field(discriminator="kind")], BeforeValidator(tagged("kind", "crash"))]
"""A scene's ``[[faults]]`` are told apart by ``kind``."""

KINDS: dict[str, type[AnyFault]] = {kind.called: kind for kind in get_args(AnyFault)}


def gist(kind: str) -> str:
    """Return a few words on a kind of fault: how its description begins."""
    first = (KINDS[kind].__doc__ or "").partition("\n")[0].replace("``", "").rstrip(".")
    return re.split(r"[.,:;] ", first, maxsplit=1)[0]
