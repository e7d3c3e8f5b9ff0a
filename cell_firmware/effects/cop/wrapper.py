"""Watchdog of cells: a program that hangs is reset and restarts (effect ``cop``)."""

from __future__ import annotations

from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.controller import (
    Controller,
    ControllerOutputs,
    ControllerState,
    ControllerWrapper,
    StepTime,
)
from cell_firmware.effects.cop.spec import DIVIDER_S, CopSpec
from cell_firmware.firmware import Bools, Cells, Inputs, State
from cell_firmware.specs import nanoseconds

DIVIDER_NS: Final = nanoseconds(DIVIDER_S)


@final
class WatchdogWrapper(ControllerWrapper):
    """Wrapper that resets cells whose program does not serve the watchdog in time.

    The control interrupt and the watchdog's counter divide the same crystal, from the same instant on: with both in the
    cell's own time, m periods at its control instant m, nothing of it depends on how far the crystal is off. A service
    clears the counter, which counts boundaries of the divider; the reset comes at the first boundary that is not before
    the last service plus the timeout. It is acted on at the cell's next control instant.

    A program that raises hangs: it no longer serves, the pins are held, and nothing is sent. A program that runs but
    doesn't serve (``Outputs.served``) continues until it is reset. What a reset keeps is the crystal, the divider,
    the state that board components keep (``BoardComponent.reset``, ``BoardComponent.idle``), and the program's state
    that ``warm_start`` keeps; all else is as after power-on. The wheels are at 0 until the program starts, at
    the first control instant after ``reboot_s``; till then its start-up code serves.

    Args:
        controller: Of the cells.
        spec: Timeout and reboot.
        period_ns: The control period, in the cells' own time.

    Attributes:
        timeout_ns: Time after a service until the watchdog resets the cell.
        reboot_ns: Time from the reset until the program starts.
        period_ns: The control period.
    """

    part = "cop"
    shown = ("hung", "hangs", "resets")

    def __init__(self, controller: Controller, spec: CopSpec, period_ns: int) -> None:
        super().__init__(controller)
        self.timeout_ns = nanoseconds(spec.timeout_s)
        self.reboot_ns = round(spec.reboot_s * 1e9)
        self.period_ns = period_ns

    def init(self, cells: Cells) -> ControllerState:
        """The state before tick 0: power-on clears the counters."""
        n = len(cells)
        watch: State = {
            "instants": np.zeros(n, dtype=np.int64),
            "served_ns": np.zeros(n, dtype=np.int64),
            "starts_ns": np.zeros(n, dtype=np.int64),
            "hung": np.zeros(n, dtype=np.bool_),
            "drive": np.zeros((n, 2)),
            "hangs": np.zeros(n, dtype=np.int64),
            "resets": np.zeros(n, dtype=np.int64),
        }
        return self.wrap_state(self.controller.init(cells), watch)

    def receive(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, Inputs]:
        """Receive from the lines, also for cells whose program hangs."""
        inner, inputs = self.controller.receive(now, self.unwrap_state(state), inputs)
        return self.wrap_state(inner, state.parts[self.part]), inputs

    def compute(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """One control period: resets, and a step of the programs that run."""
        watch = state.parts[self.part]
        at_ns = watch["instants"] * self.period_ns
        inner, watch = self._reset(at_ns, self.unwrap_state(state), watch)
        runs = ~watch["hung"] & (at_ns >= watch["starts_ns"])
        waits = np.flatnonzero(~runs)
        if len(waits):
            inner = inner.replace_rows(waits, self.controller.idle(now.select(waits), inner.select(waits)))
        inner, outputs = self.controller.compute_rows(np.flatnonzero(runs), now, inner, inputs)
        after: dict[str, NDArray[Any]] = {**watch, "instants": watch["instants"] + 1}
        if len(waits) or outputs.failures:
            raised = np.zeros(len(runs), dtype=np.bool_)
            raised[list(outputs.failures)] = True
            runs &= ~raised
            after["hung"], after["hangs"] = watch["hung"] | raised, watch["hangs"] + raised
            after["drive"] = np.where(runs[:, None], outputs.drive, watch["drive"])
        else:
            after["drive"] = outputs.drive.copy()
        served = runs if outputs.served is None else runs & outputs.served
        after["served_ns"] = np.where(served, at_ns, watch["served_ns"])
        return (
            self.wrap_state(inner, after),
            ControllerOutputs(after["drive"], outputs.outbox, hung=outputs.failures),
        )

    def _reset(
        self, at_ns: NDArray[np.int64], inner: ControllerState, watch: State
    ) -> tuple[ControllerState, State]:
        """Reset cells whose watchdog has timed out."""
        if (at_ns - watch["served_ns"]).max() < self.timeout_ns:
            return inner, watch  # none can be, and dividing takes its time
        bites_ns = -(-(watch["served_ns"] + self.timeout_ns) // DIVIDER_NS) * DIVIDER_NS
        over: Bools = at_ns >= bites_ns
        if not over.any():
            return inner, watch
        rows = np.flatnonzero(over)
        starts_ns = np.where(over, bites_ns + self.reboot_ns, watch["starts_ns"])
        after: State = {
            **watch,
            "starts_ns": starts_ns,
            "served_ns": np.where(over, starts_ns, watch["served_ns"]),
            "hung": watch["hung"] & ~over,
            "drive": np.where(over[:, None], 0.0, watch["drive"]),
            "resets": watch["resets"] + over,
        }
        return inner.replace_rows(rows, self.controller.reset(inner.select(rows), warm=True)), after

    def counters(self, state: ControllerState) -> dict[str, int]:
        """Return the numbers of hangs and resets, and the counters of the wrapped controller."""
        watch = state.parts[self.part]
        own = {f"{self.part}.{name}": int(watch[name].sum()) for name in ("hangs", "resets")}
        return {**own, **super().counters(state)}
