"""Loss of a cell's power: the cells' part of faults ``crash`` and ``remove``."""

from __future__ import annotations

from typing import ClassVar, Literal

from bus.fault import CellTarget, FaultInstance
from cell_firmware.faults.base import CellFault, ExecutionFaults


class PowerLossFault(CellTarget, CellFault):
    """Cells without power. A repaired cell begins anew, as after power-on."""

    halts_program: ClassVar[bool] = True

    def execution(self, tick: int, injected: FaultInstance[CellFault], pause: ExecutionFaults) -> None:
        """No program runs; after the repair it begins anew."""
        if injected.active_at(tick):
            pause.halted[injected.cells] = True
        pause.reset[injected.cells] |= tick == injected.end_tick


class CrashedCellFault(PowerLossFault):
    """Crashed cells; ``deploy.faults.crash.CrashFault`` adds the plant's part."""

    kind_name: ClassVar[str] = "crash"
    kind: Literal["crash"] = "crash"
    wheels: Literal["coast", "brake", "hold"] | None = None
    """What the dead wheels do; None: what the scene's stall policy says."""


class RemovedCellFault(PowerLossFault):
    """Removed cells; ``deploy.faults.modules.RemoveFault`` adds the plant's part."""

    kind_name: ClassVar[str] = "remove"
    kind: Literal["remove"]
