"""Fault ``reboot``: a cell loses power for a moment, and its state with it."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import ClassVar, Literal, final

from bus.fault import CellTarget, FaultInstance, Time
from cell_firmware.faults.base import CellFault, ExecutionFaults


@final
class RebootFault(CellTarget, CellFault):
    """Cells restart as after power-on after a stop of ``delay_s``; all their state is lost.

    From the first tick not before ``at_s`` to the first not before ``at_s + delay_s`` wheels are commanded to 0,
    nothing is sent, and start-up code serves the watchdog, as after a reset by it.
    """

    kind_name: ClassVar[str] = "reboot"
    repairable: ClassVar[bool] = False
    halts_program: ClassVar[bool] = True
    kind: Literal["reboot"] = "reboot"
    delay_s: Time = 0.05
    """Time from the loss of state to the start of the program."""

    def tick_range(self, tick_at: Callable[[float], int]) -> tuple[int, int]:
        """Return the interval of ticks until programs start."""
        # of the decimals as they are given: 0.1 and 0.2 are 0.3, and no tick more
        starts_s = Fraction(repr(self.at_s)) + Fraction(repr(self.delay_s))
        return tick_at(self.at_s), tick_at(float(starts_s))

    def execution(self, tick: int, injected: FaultInstance[CellFault], pause: ExecutionFaults) -> None:
        """Halt the affected programs, and reset them at the start and at the end, so that no message is retained."""
        if injected.active_at(tick):
            pause.halted[injected.cells] = True
        pause.reset[injected.cells] |= tick in (injected.start_tick, injected.end_tick)
