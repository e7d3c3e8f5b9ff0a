"""Wrappers for faults that halt or reset programs, or skip control periods."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultInstance
from cell_firmware.clocks import NOT_IN_WINDOW
from cell_firmware.controller import ControllerOutputs, ControllerState, StepTime
from cell_firmware.faults.base import CellFault, ExecutionFaults, FaultWrapper
from cell_firmware.firmware import Bools, Floats, Inbox, Inputs, State, opaque_view


@final
class ClockFaultWrapper(FaultWrapper):
    """Wrapper that skips control periods of cells with a slow clock; drives are held in between.

    The wrapped controller, including the watchdog, does not see the skipped periods. Lines receive in skipped periods
    too, but a message that is delivered whole, without a mailbox or receive ring, is lost with its period.

    This wrapper is outside of the watchdog, whose counter is slowed as well.
    """

    part = "slow_clock"
    shown = ("skipped",)

    def begin(self, inner: ControllerState, drive: Floats | None = None) -> ControllerState:
        """Return the state of cells without skipped periods so far."""
        n = len(inner.cells)
        own: State = {
            "place": self.lattice.find(inner.cells.row, inner.cells.column),
            "drive": np.zeros((n, 2)) if drive is None else drive.copy(),
            "runs": np.ones(n, dtype=np.bool_),
            "skipped": np.zeros(n, dtype=np.int64),
            **{str(one.number): np.zeros(n, dtype=np.int64) for one in self.faults},
        }
        return self.wrap_state(inner, own)

    def receive(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, Inputs]:
        """Receive from the lines, for the cells that run."""
        own, tick = dict(state.parts[self.part]), now.tick + self.start_tick
        steps, runs = np.asarray(now.at_ns >= 0), np.ones(len(state.cells), dtype=np.bool_)
        for injected in self.faults:
            if not injected.active_at(tick):
                continue
            periods = own.get(str(injected.number), np.zeros(len(runs), dtype=np.int64))
            runs &= ~np.isin(own["place"], injected.cells) | injected.fault.running_periods(periods)
            own[str(injected.number)] = periods + steps
        then = now if runs.all() else StepTime(now.tick, np.where(runs, now.at_ns, NOT_IN_WINDOW))
        inner, inputs = self.controller.receive(then, self.unwrap_state(state), inputs)
        after = {
            **own,
            "runs": runs,
            "skipped": own["skipped"] + (steps & ~runs),
        }
        return self.wrap_state(inner, after), inputs

    def compute(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """Compute a control period of the cells that run."""
        own = state.parts[self.part]
        inner, outputs = self.controller.compute_rows(
            np.flatnonzero(own["runs"]), now, self.unwrap_state(state), inputs
        )
        drive = np.where(own["runs"][:, None], outputs.drive, own["drive"])
        return (
            self.wrap_state(inner, {**own, "drive": drive.copy()}),
            ControllerOutputs(drive, outputs.outbox, outputs.failures, outputs.served, outputs.hung),
        )

    def catch_up(self, own: State, drive: Floats) -> State:
        """Return the state with the current drives."""
        return {**own, "drive": drive.copy()}

    def counters(self, state: ControllerState) -> dict[str, int]:
        """Return the number of skipped periods."""
        skipped = int(state.parts[self.part]["skipped"].sum())
        return {f"faults.{self.part}.periods": skipped, **super().counters(state)}


@final
class ExecutionFaultWrapper(FaultWrapper):
    """Wrapper that halts and restarts programs.

    A halted program sends nothing; the other parts of its board continue (``Controller.idle``), and its wheels are
    commanded to 0 or held. A restarted program has lost its state except the observer's counters, and its wheels are
    commanded to 0 until it commands them.

    Actions of faults are recorded in every exchange, for all cells, and carried out when the cell is stepped: cells
    with their own clocks are not stepped in every exchange, and a cell repaired in between still restarts.

    This wrapper is inside of the watchdog, which resets a program that hangs.
    """

    part = "faults"
    shown = ("stopped", "restarts")

    def begin(self, inner: ControllerState, drive: Floats | None = None) -> ControllerState:
        """Return the state of cells whose programs have not been halted so far."""
        n = len(inner.cells)
        own = {
            "place": self.lattice.find(inner.cells.row, inner.cells.column),
            "drive": np.zeros((n, 2)) if drive is None else drive.copy(),
            **{name: np.zeros(n, dtype=np.bool_) for name in ("stopped", "keeps", "unserved", "reset")},
            "restarts": np.zeros(n, dtype=np.int64),
            "deaf_until": np.zeros(n, dtype=np.int64),
            **{_periods(one): np.zeros(n, dtype=np.int64) for one in self.faults},
        }
        return self.wrap_state(inner, own)

    def reset(self, state: ControllerState, *, warm: bool = False) -> ControllerState:
        """Reset the wrapped controller; drives become 0, and a pending restart is cancelled."""
        own = state.parts[self.part]
        after = {**own, "drive": np.zeros_like(own["drive"]), "reset": np.zeros_like(own["reset"])}
        return self.wrap_state(self.controller.reset(self.unwrap_state(state), warm=warm), after)

    def receive(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, Inputs]:
        """Receive from the lines, and record the actions of faults."""
        inner, inputs = self.controller.receive(now, self.unwrap_state(state), inputs)
        own = state.parts[self.part]
        place, steps = own["place"], np.asarray(now.at_ns >= 0)
        pause, periods = ExecutionFaults.none(len(self.lattice)), dict[str, NDArray[Any]]()
        for injected in self.faults:
            before = pause.halted.copy()
            injected.fault.execution(now.tick + self.start_tick, injected, pause)
            name = _periods(injected)
            stands = (pause.halted & ~before)[place] & steps
            periods[name] = periods.get(name, own.get(name, 0)) + stands
        noted = {
            "stopped": pause.halted[place],
            "keeps": pause.outputs_held[place],
            "unserved": pause.watchdog_unserved[place],
            "reset": own["reset"] | pause.reset[place],
        }
        return self.wrap_state(inner, {**own, **noted, **periods}), inputs

    def compute(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """Compute a control period of the programs that run."""
        own, inner = state.parts[self.part], self.unwrap_state(state)
        stopped, reset, before = own["stopped"], own["reset"], own["drive"]
        if reset.any():
            rows = np.flatnonzero(reset)
            inner = inner.replace_rows(rows, self.controller.reset(inner.select(rows)))
            before = np.where(reset[:, None], 0.0, before)
        # a program reads no message that was sent before it restarted
        deaf_until = np.where(reset, now.tick + self.link_ticks, own["deaf_until"])
        deaf = deaf_until > now.tick
        if deaf.any():
            inputs = _unheard(inputs, np.flatnonzero(deaf))
        if not stopped.any():
            inner, outputs = self.controller.compute(now, inner, inputs)
            drive, served = outputs.drive, outputs.served
        else:
            waits = np.flatnonzero(stopped)
            inner = inner.replace_rows(waits, self.controller.idle(now.select(waits), inner.select(waits)))
            inner, outputs = self.controller.compute_rows(np.flatnonzero(~stopped), now, inner, inputs)
            drive = np.where((stopped & own["keeps"])[:, None], before, outputs.drive)
            served = _served(stopped, own["unserved"], outputs.served)
        after: State = {
            **own,
            "drive": drive.copy(),
            "reset": np.zeros_like(reset),
            "deaf_until": deaf_until,
            "restarts": own["restarts"] + (reset & ~stopped),
        }
        return (
            self.wrap_state(inner, after),
            ControllerOutputs(drive, outputs.outbox, outputs.failures, served, outputs.hung),
        )

    def is_settled(self, tick: int, own: State) -> bool:
        """Whether all programs run, none is about to restart, and all may read the messages of the tick."""
        waits = own["stopped"] | own["reset"] | (own["deaf_until"] > tick - self.start_tick)
        return not waits.any()

    def catch_up(self, own: State, drive: Floats) -> State:
        """Return the state with the current drives."""
        return {**own, "drive": drive.copy()}

    def counters(self, state: ControllerState) -> dict[str, int]:
        """Return the periods in which programs were halted, by kind of fault, and the number of restarts."""
        own = state.parts[self.part]
        counters = {
            f"{self.part}.{name.removeprefix(_PERIODS)}.periods": int(value.sum())
            for name, value in own.items()
            if name.startswith(_PERIODS)
        }
        return {
            **counters,
            f"{self.part}.restarts": int(own["restarts"].sum()),
            **super().counters(state),
        }


_PERIODS = "periods_"


def _periods(injected: FaultInstance[CellFault]) -> str:
    """Name the counter of periods in which faults of this kind halted programs."""
    return f"{_PERIODS}{injected.fault.kind_name}"


def _unheard(inputs: Inputs, rows: NDArray[np.int64]) -> Inputs:
    """Return the inputs without messages to these cells."""
    if inputs.inbox is None:
        return inputs
    received, message = inputs.inbox.received.copy(), inputs.inbox.message.copy()
    received[rows] = False
    slots = opaque_view(message)
    slots[rows] = np.zeros((), dtype=slots.dtype)
    return replace(inputs, inbox=Inbox(received, message))


def _served(stopped: Bools, unserved: Bools, inner: Bools | None) -> Bools:
    """Return which watchdogs are served; a halted program's watchdog is, unless the fault prevents it."""
    return np.where(stopped, ~unserved, True if inner is None else inner)
