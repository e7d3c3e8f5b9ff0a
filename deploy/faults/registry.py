"""Every fault that a scene may schedule: a new one is a file and a line here."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, Field

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
    | RemoveFault
    | AddFault
    | WheelStuckFault
    | WheelWeakFault
    | WheelReversedFault
    | WheelRunawayFault
)

Fault = Annotated[Annotated[AnyFault, Field(discriminator="kind")], BeforeValidator(tagged("kind", "crash"))]
"""A scene's ``[[faults]]`` are told apart by ``kind``."""

KINDS: dict[str, type[AnyFault]] = {
    fault.called: fault
    for fault in (
        CrashFault,
        RemoveFault,
        AddFault,
        WheelStuckFault,
        WheelWeakFault,
        WheelReversedFault,
        WheelRunawayFault,
    )
}
