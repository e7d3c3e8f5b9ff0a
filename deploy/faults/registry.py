"""Registry of all fault kinds; a new kind that acts in the plant too is a module and a line here."""

from __future__ import annotations

import re
from typing import Annotated, Final, get_args

from pydantic import BeforeValidator, Field

from cell_firmware.faults.registry import CellOnlyFault
from deploy.faults.crash import CrashFault
from deploy.faults.modules import AddFault, RemoveFault
from plant.faults.kinds.wheel_reversed import WheelReversedFault
from plant.faults.kinds.wheel_runaway import WheelRunawayFault
from plant.faults.kinds.wheel_stuck import WheelStuckFault
from plant.faults.kinds.wheel_weak import WheelWeakFault
from plant.tagged import tagged

AnyFault = (
    CrashFault  # the default
    | RemoveFault
    | AddFault
    | WheelStuckFault
    | WheelWeakFault
    | WheelReversedFault
    | WheelRunawayFault
    | CellOnlyFault
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
