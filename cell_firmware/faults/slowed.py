"""Cells whose clock is slow because a fault says so: they are stepped in some of their control periods only."""

from __future__ import annotations

from typing import final

import numpy as np

from cell_firmware.clocked import Clocked
from cell_firmware.clocks import NEVER
from cell_firmware.controller import ControllerOutputs, ControllerState, Instant
from cell_firmware.faults.around import FaultAround
from cell_firmware.firmware import Floats, Inputs, State


@final
class Slowed(FaultAround):
    """Steps the cells in the periods in which their clock lets them; what they drive holds in between.

    Their controller, watchdog and all, knows nothing of the periods between. Lines are listened to in each of them, but
    a message that goes over whole, without a mailbox or a ring to wait in, is lost with its period.

    It is around the watchdog, whose counter is as slow.
    """

    part = "slow_clock"
    beneath = (Clocked,)
    shown = ("skipped",)

    def begin(self, inner: ControllerState, drive: Floats | None = None) -> ControllerState:
        """The state of cells none of whose periods was counted so far."""
        n = len(inner.cells)
        own: State = {
            "place": self.lattice.find(inner.cells.row, inner.cells.column),
            "drive": np.zeros((n, 2)) if drive is None else drive.copy(),
            "runs": np.ones(n, dtype=np.bool_),
            "skipped": np.zeros(n, dtype=np.int64),
            **{str(one.number): np.zeros(n, dtype=np.int64) for one in self.faults},
        }
        return self.outer(inner, own)

    def listen(self, now: Instant, state: ControllerState, inputs: Inputs) -> tuple[ControllerState, Inputs]:
        """What came over the lines, for the cells that run."""
        own, tick = dict(state.parts[self.part]), now.tick + self.lag
        steps, runs = np.asarray(now.at_ns >= 0), np.ones(len(state.cells), dtype=np.bool_)
        for injected in self.faults:
            if not injected.acts(tick):
                continue
            periods = own.get(str(injected.number), np.zeros(len(runs), dtype=np.int64))
            runs &= ~np.isin(own["place"], injected.cells) | injected.fault.runs(periods)
            own[str(injected.number)] = periods + steps
        then = now if runs.all() else Instant(now.tick, np.where(runs, now.at_ns, NEVER))
        inner, inputs = self.controller.listen(then, self.inner(state), inputs)
        after = {
            **own,
            "runs": runs,
            "skipped": own["skipped"] + (steps & ~runs),
        }
        return self.outer(inner, after), inputs

    def act(
        self, now: Instant, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """One control period of those that run."""
        own = state.parts[self.part]
        inner, outputs = self.controller.act_on(np.flatnonzero(own["runs"]), now, self.inner(state), inputs)
        drive = np.where(own["runs"][:, None], outputs.drive, own["drive"])
        return (
            self.outer(inner, {**own, "drive": drive.copy()}),
            ControllerOutputs(drive, outputs.outbox, outputs.failures, outputs.served, outputs.hung),
        )

    def counted(self, state: ControllerState) -> dict[str, int]:
        """Periods that cells missed."""
        skipped = int(state.parts[self.part]["skipped"].sum())
        return {f"faults.{self.part}.periods": skipped, **super().counted(state)}
