"""Crash fault: from one tick on the cell computes, drives and sends nothing."""

from __future__ import annotations

from typing import ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import CellTarget, FaultInstance
from cell_firmware.faults.base import CellFault, ExecutionFaults
from plant.faults.base import PlantFault, WheelFaults
from plant.wheels import LossPolicy


@final
class CrashFault(CellTarget, CellFault, PlantFault):
    """Cells die permanently or until a repair, which restarts their programs as after power-on.

    A cell without a repair leaves the lockstep too. A worker process all of whose cells are dead ends itself by
    SIGKILL, like a process that dies; in a shared worker the cell's agent stops.
    """

    kind_name: ClassVar[str] = "crash"
    halts_program: ClassVar[bool] = True
    kind: Literal["crash"] = "crash"
    wheels: LossPolicy | None = None
    """Behaviour of the dead cells' wheels; None: the scene's ``stall.policy``."""

    def execution(self, tick: int, injected: FaultInstance[CellFault], pause: ExecutionFaults) -> None:
        """Halt the affected programs; restart them at the repair."""
        if injected.active_at(tick):
            pause.halted[injected.cells] = True
        pause.reset[injected.cells] |= tick == injected.end_tick

    def apply(self, cells: NDArray[np.int64], wheel_faults: WheelFaults) -> None:
        """Nobody drives the wheels."""
        wheel_faults.dead[cells] = True
        if self.wheels is not None:
            wheel_faults.wheel_policies.update(dict.fromkeys(cells.tolist(), self.wheels))
