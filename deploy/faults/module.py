"""Modules that are not in the array for a while: what pulling one and plugging it in have in common."""

from __future__ import annotations

from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from bus.fault import CellTarget, Injected
from cell_firmware.faults.fault import CellFault, Pause
from plant.faults.fault import Harm, PlantFault


class AbsentModules(CellTarget, CellFault, PlantFault):
    """Cells that are gone while it acts: no wheels under parcels, no sensors, no program, no links.

    Plugged in again they begin anew, as after power-on: wheels at rest, encoders going on from where they stood.
    """

    pauses: ClassVar[bool] = True

    def pause(self, tick: int, injected: Injected[CellFault], pause: Pause) -> None:
        """No program runs; once it is plugged in it begins anew."""
        if injected.acts(tick):
            pause.stopped[injected.cells] = True
        pause.reset[injected.cells] |= tick == injected.end

    def harm(self, cells: NDArray[np.int64], harm: Harm) -> None:
        """The cells are not in the array."""
        harm.gone[cells] = True
