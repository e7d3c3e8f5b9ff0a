"""Fault ``hang``: a cell's program is halted."""

from __future__ import annotations

from typing import ClassVar, Literal, final

from bus.fault import CellTarget, FaultInstance
from cell_firmware.faults.base import CellFault, ExecutionFaults


@final
class HangFault(CellTarget, CellFault):
    """Programs hang: pins are held, nothing is sent, and the watchdog is not served.

    A cell with a watchdog (effect ``cop``) is reset, restarts, and hangs again at once while the fault is active. A
    repair resets the program too, since an endless loop does not end.
    """

    kind_name: ClassVar[str] = "hang"
    halts_program: ClassVar[bool] = True
    kind: Literal["hang"] = "hang"

    def execution(self, tick: int, injected: FaultInstance[CellFault], pause: ExecutionFaults) -> None:
        """Halt the affected programs; restart them at the repair."""
        if injected.active_at(tick):
            for flags in (pause.halted, pause.outputs_held, pause.watchdog_unserved):
                flags[injected.cells] = True
        pause.reset[injected.cells] |= tick == injected.end_tick
