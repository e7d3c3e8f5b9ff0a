"""Crash fault: from one tick on the cell computes, drives and sends nothing."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.faults.kinds.power_loss import CrashedCellFault
from plant.faults.base import PlantFault, WheelFaults


@final
class CrashFault(CrashedCellFault, PlantFault):
    """Cells die permanently or until a repair, which restarts their programs as after power-on.

    A cell without a repair leaves the lockstep too. A worker process all of whose cells are dead ends itself by
    SIGKILL, like a process that dies; in a shared worker the cell's agent stops.
    """

    def apply(self, cells: NDArray[np.int64], wheel_faults: WheelFaults) -> None:
        """Nobody drives the wheels."""
        wheel_faults.dead[cells] = True
        if self.wheels is not None:
            wheel_faults.wheel_policies.update(dict.fromkeys(cells.tolist(), self.wheels))
