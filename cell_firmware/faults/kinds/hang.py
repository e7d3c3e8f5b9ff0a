"""Fault ``hang``: a cell's program stands still."""

from __future__ import annotations

from typing import ClassVar, Literal, final

from bus.fault import CellTarget, Injected
from cell_firmware.faults.base import CellFault, Pause


@final
class HangFault(CellTarget, CellFault):
    """Programs that hang: pins keep what they had, nothing is sent, nobody serves the watchdog.

    Where the cell has one (effect ``cop``) it is reset, begins anew, and hangs again at once while the fault acts.
    Repaired, it is reset too: a loop without an end does not end by itself.
    """

    called: ClassVar[str] = "hang"
    pauses: ClassVar[bool] = True
    kind: Literal["hang"] = "hang"

    def pause(self, tick: int, injected: Injected[CellFault], pause: Pause) -> None:
        """No program runs; after the repair it begins anew."""
        if injected.acts(tick):
            for flags in (pause.stopped, pause.keeps, pause.unserved):
                flags[injected.cells] = True
        pause.reset[injected.cells] |= tick == injected.end
