"""A cell dies: from one tick on it computes, drives and sends nothing."""

from __future__ import annotations

from typing import ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import CellTarget, Injected
from cell_firmware.faults.base import CellFault, Pause
from plant.faults.base import Harm, PlantFault
from plant.wheels import LossPolicy


@final
class CrashFault(CellTarget, CellFault, PlantFault):
    """Cells that die. Repaired, they begin anew, as after power-on.

    One that is not repaired is gone from the lockstep too: a worker process all of whose cells are dead ends itself by
    SIGKILL, as a real death does; in a shared worker the cell's agent stops.
    """

    called: ClassVar[str] = "crash"
    pauses: ClassVar[bool] = True
    kind: Literal["crash"] = "crash"
    wheels: LossPolicy | None = None
    """What the dead wheels do; None: what the scene's stall policy says."""

    def pause(self, tick: int, injected: Injected[CellFault], pause: Pause) -> None:
        """No program runs; after the repair it begins anew."""
        if injected.acts(tick):
            pause.stopped[injected.cells] = True
        pause.reset[injected.cells] |= tick == injected.end

    def harm(self, cells: NDArray[np.int64], harm: Harm) -> None:
        """Nobody drives the wheels."""
        harm.dead[cells] = True
        if self.wheels is not None:
            harm.rests.update(dict.fromkeys(cells.tolist(), self.wheels))
