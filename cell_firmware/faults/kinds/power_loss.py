"""Faults ``crash`` and ``remove`` as the cells see them: programs that lose their power."""

from __future__ import annotations

from typing import ClassVar, Literal

from bus.fault import CellTarget, FaultInstance
from cell_firmware.faults.base import CellFault, ExecutionFaults


class PowerLossFault(CellTarget, CellFault):
    """Cells whose program does not run. Repaired, they begin anew, as after power-on."""

    halts_program: ClassVar[bool] = True

    def execution(self, tick: int, injected: FaultInstance[CellFault], pause: ExecutionFaults) -> None:
        """No program runs; after the repair it begins anew."""
        if injected.active_at(tick):
            pause.halted[injected.cells] = True
        pause.reset[injected.cells] |= tick == injected.end_tick


class CrashedCellFault(PowerLossFault):
    """Cells that die: of a crash, what happens in the cells."""

    kind_name: ClassVar[str] = "crash"
    kind: Literal["crash"] = "crash"
    wheels: Literal["coast", "brake", "hold"] | None = None
    """What the dead wheels do; None: what the scene's stall policy says."""


class RemovedCellFault(PowerLossFault):
    """Cells that are pulled out: of a removal, what happens in the cells."""

    kind_name: ClassVar[str] = "remove"
    kind: Literal["remove"]
