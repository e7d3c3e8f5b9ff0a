"""Crash fault: from one tick on the cell computes, drives and sends nothing."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.faults.kinds.power_loss import CrashedCellFault
from plant.faults.base import PlantFault, WheelFaults


@final
class CrashFault(CrashedCellFault, PlantFault):
    """Cells that die. Repaired, they begin anew, as after power-on.

    One that is not repaired is gone from the lockstep too: a worker process all of whose cells are dead ends itself by
    SIGKILL, as a real death does; in a shared worker the cell's agent stops.
    """

    def apply(self, cells: NDArray[np.int64], harm: WheelFaults) -> None:
        """Nobody drives the wheels."""
        harm.dead[cells] = True
        if self.wheels is not None:
            harm.wheel_policies.update(dict.fromkeys(cells.tolist(), self.wheels))
