"""Loss of a cell's power: the cells' part of faults ``crash`` and ``remove``."""

from __future__ import annotations

from typing import ClassVar, Literal

from bus.fault import CellTarget, FaultInstance
from cell_firmware.faults.base import CellFault, ExecutionFaults


class PowerLossFault(CellTarget, CellFault):
    """Cells whose program does not run; it restarts at the repair, as after power-on."""

    halts_program: ClassVar[bool] = True

    def execution(self, tick: int, injected: FaultInstance[CellFault], pause: ExecutionFaults) -> None:
        """Halt the affected programs; restart them at the repair."""
        if injected.active_at(tick):
            pause.halted[injected.cells] = True
        pause.reset[injected.cells] |= tick == injected.end_tick


class CrashedCellFault(PowerLossFault):
    """Crashed cells; ``deploy.faults.crash.CrashFault`` adds the plant's part."""

    kind_name: ClassVar[str] = "crash"
    kind: Literal["crash"] = "crash"
    wheels: Literal["coast", "brake", "hold"] | None = None
    """Behaviour of the dead cells' wheels; None: the scene's ``stall.policy``."""


class RemovedCellFault(PowerLossFault):
    """Removed cells; ``deploy.faults.modules.RemoveFault`` adds the plant's part."""

    kind_name: ClassVar[str] = "remove"
    kind: Literal["remove"]
