"""Jammed wheel: the surface stands whatever the drive, and brakes parcels on it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import Problem
from plant.faults.base import WheelFault, WheelFaults

if TYPE_CHECKING:
    from plant.effects.registry import PlantEffects


@final
class WheelStuckFault(WheelFault):
    """Wheels jam and stop at once; after a repair they start from rest. Jammed wheels of a dead cell don't coast."""

    kind_name: ClassVar[str] = "wheel_stuck"
    kind: Literal["wheel_stuck"]

    def setting_problems(self, effects: PlantEffects) -> Iterator[Problem]:
        """A jammed wheel is one of inertia without end; ``wheel_load`` gives all the same."""
        if effects.wheel_load is not None:
            yield ("kind",), self.kind, "does not go with effects.wheel_load, in which no wheel can jam"

    def apply(self, cells: NDArray[np.int64], wheel_faults: WheelFaults) -> None:
        """They don't turn."""
        wheel_faults.stuck[self.wheels(cells)] = True
