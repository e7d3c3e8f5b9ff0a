"""Fault ``hang``: a cell's program stands still."""

from __future__ import annotations

from typing import ClassVar, Literal, final

from bus.fault import CellTarget, FaultInstance
from cell_firmware.faults.base import CellFault, ExecutionFaults


@final
class HangFault(CellTarget, CellFault):
    """Programs that hang: pins keep what they had, nothing is sent, nobody serves the watchdog.

    Where the cell has one (effect ``cop``) it is reset, begins anew, and hangs again at once while the fault acts.
    Repaired, it is reset too: a loop without an end does not end by itself.
    """

    kind_name: ClassVar[str] = "hang"
    halts_program: ClassVar[bool] = True
    kind: Literal["hang"] = "hang"

    def execution(self, tick: int, injected: FaultInstance[CellFault], pause: ExecutionFaults) -> None:
        """No program runs; after the repair it begins anew."""
        if injected.active_at(tick):
            for flags in (pause.halted, pause.outputs_held, pause.watchdog_unserved):
                flags[injected.cells] = True
        pause.reset[injected.cells] |= tick == injected.end_tick
