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
    """Cells that are gone while it acts: no wheels under parcels, no sensors, no program, no links.

    Plugged in again they begin anew, as after power-on: wheels at rest, encoders going on from where they stood.
    """

    def apply(self, cells: NDArray[np.int64], harm: WheelFaults) -> None:
        """The cells are not in the array."""
        harm.gone[cells] = True


@final
class AddFault(AbsentModuleFault):
    """Cells that are not there at the start, and are from ``at_s`` on."""

    kind_name: ClassVar[str] = "add"
    kind: Literal["add"]

    @model_validator(mode="after")
    def _comes_once(self) -> Self:
        if self.at_s == 0.0:
            raise ValueError("at_s must be > 0: what is added at the start is there")
        if self.until_s is not None:
            raise ValueError("what is added stays: leave until_s out, and pull it by a fault of kind remove")
        return self

    def tick_range(self, tick_at: Callable[[float], int]) -> tuple[int, int]:
        """It acts until its cells are there."""
        return 0, tick_at(self.at_s)


@final
class RemoveFault(RemovedCellFault, AbsentModuleFault):
    """Cells that are pulled out of the array at ``at_s``, and plugged in again where ``until_s`` says so."""
