"""Base of faults in which modules are absent from the array for a while."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Literal, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import model_validator

from cell_firmware.faults.kinds.power_loss import PowerLossFault, RemovedCellFault
from plant.faults.base import PlantFault, WheelFaults


class AbsentModuleFault(PowerLossFault, PlantFault):
    """A fault that removes cells from the array while active: no wheels, no sensors, no program, no links.

    Cells that are plugged in restart as after power-on, with wheels at rest; encoders continue at their last counts.
    """

    def apply(self, cells: NDArray[np.int64], wheel_faults: WheelFaults) -> None:
        """The cells are not in the array."""
        wheel_faults.gone[cells] = True


@final
class AddFault(AbsentModuleFault):
    """Cells are added to the array at ``at_s``; before, they are absent."""

    kind_name: ClassVar[str] = "add"
    kind: Literal["add"]

    @model_validator(mode="after")
    def _comes_once(self) -> Self:
        if self.at_s == 0.0:
            raise ValueError("at_s must be > 0: cells that are present from the start need no fault add")
        if self.until_s is not None:
            raise ValueError("added cells stay: leave until_s out, and pull them by a fault of kind remove")
        return self

    def tick_range(self, tick_at: Callable[[float], int]) -> tuple[int, int]:
        """Return the ticks in which the cells are absent: from the start of the run to ``at_s``."""
        return 0, tick_at(self.at_s)


@final
class RemoveFault(RemovedCellFault, AbsentModuleFault):
    """Cells are removed from the array at ``at_s``, and plugged in again at ``until_s`` if given."""
