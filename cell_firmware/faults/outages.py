"""Cells whose program stands still, or begins anew, because a fault says so."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import final

import numpy as np
from numpy.typing import NDArray

from bus.fault import Injected
from bus.lattice import Lattice
from cell_firmware.around import Around
from cell_firmware.clocked import Clocked
from cell_firmware.controller import Controller, ControllerOutputs, ControllerState, Instant
from cell_firmware.faults.fault import CellFault, Pause
from cell_firmware.firmware import Bools, Cells, Inbox, Inputs, solid


@final
class Outages(Around):
    """Steps the cells whose programs no fault has stopped.

    A program that stands still sends nothing; its parts go on as on a board without power for their program
    (``Controller.idle``), and its wheels are commanded to 0 or to what they were. One that begins anew has forgotten
    everything, as after power-on.

    Args:
        controller: Of the cells.
        lattice: Of the array.
        faults: Those that act on programs.
        lag: By how many ticks an instant is older than the exchange in which its cells are stepped: 1 where cells have
            clocks of their own.
    """

    part = "faults"
    shown = ("stopped", "begun_anew")

    def __init__(
        self,
        controller: Controller,
        lattice: Lattice,
        faults: Sequence[Injected[CellFault]] = (),
        *,
        lag: int = 0,
    ) -> None:
        super().__init__(controller)
        self._lattice = lattice
        self._faults = list(faults)
        self._lag = lag

    def add(self, fault: Injected[CellFault]) -> None:
        """One more, from its first tick on."""
        self._faults.append(fault)

    def init(self, cells: Cells) -> ControllerState:
        """The state before tick 0."""
        return self.begin(self.controller.init(cells))

    def begin(self, inner: ControllerState) -> ControllerState:
        """The state of cells whose programs nothing has stopped so far."""
        n = len(inner.cells)
        own = {
            "place": self._lattice.find(inner.cells.row, inner.cells.column),
            "drive": np.zeros((n, 2)),
            "stopped": np.zeros(n, dtype=np.bool_),
            "begun_anew": np.zeros(n, dtype=np.int64),
        }
        return self.outer(inner, own)

    def after_reset(self, state: ControllerState) -> ControllerState:
        """What the cells' controller keeps of itself; faults know nothing of resets."""
        own = state.parts[self.part]
        return self.outer(self.controller.after_reset(self.inner(state)), own)

    def listen(self, now: Instant, state: ControllerState, inputs: Inputs) -> tuple[ControllerState, Inputs]:
        """What came over the lines."""
        inner, inputs = self.controller.listen(now, self.inner(state), inputs)
        return self.outer(inner, state.parts[self.part]), inputs

    def act(
        self, now: Instant, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """One control period of the programs that run."""
        own, inner = state.parts[self.part], self.inner(state)
        pause = Pause.none(len(self._lattice))
        for injected in self._faults:
            injected.fault.pause(now.tick + self._lag, injected, pause)
        place = own["place"]
        stopped, reset = pause.stopped[place], pause.reset[place]
        if reset.any():
            rows = np.flatnonzero(reset)
            inner = inner.put(rows, self.controller.init(inner.cells.take(rows)))
            inputs = _unheard(inputs, rows)
        if not stopped.any():
            inner, outputs = self.controller.act(now, inner, inputs)
            drive, served = outputs.drive, outputs.served
        else:
            waits = np.flatnonzero(stopped)
            inner = inner.put(waits, self.controller.idle(now.take(waits), inner.take(waits)))
            inner, outputs = self.controller.act_on(np.flatnonzero(~stopped), now, inner, inputs)
            drive = np.where((stopped & pause.keeps[place])[:, None], own["drive"], outputs.drive)
            served = _served(stopped, pause.unserved[place], outputs.served)
        after = {
            **own,
            "drive": drive.copy(),
            "stopped": stopped,
            "begun_anew": own["begun_anew"] + reset,
        }
        return (
            self.outer(inner, after),
            ControllerOutputs(drive, outputs.outbox, outputs.failures, served, outputs.hung),
        )


def interrupted(
    controller: Controller, state: ControllerState, lattice: Lattice, fault: Injected[CellFault]
) -> tuple[Controller, ControllerState]:
    """A controller of cells that run already, one more fault acting on their programs; and its state.

    Args:
        controller: It, or what is inside of it, is changed.
        state: Of its cells.
        lattice: Of the array.
        fault: Which.
    """
    around: Around | None = None
    inside, lag = controller, 0
    while isinstance(inside, Around) and not isinstance(inside, Outages):
        lag = 1 if isinstance(inside, Clocked) else lag
        around, inside = inside, inside.controller
    if isinstance(inside, Outages):
        inside.add(fault)
        return controller, state
    outages = Outages(inside, lattice, (fault,), lag=lag)
    if around is None:
        controller = outages
    else:
        around.controller = outages
    return controller, outages.begin(state)


def _unheard(inputs: Inputs, rows: NDArray[np.int64]) -> Inputs:
    """The inputs, but these cells hear nothing: what was sent to them came before they began."""
    if inputs.inbox is None:
        return inputs
    received, message = inputs.inbox.received.copy(), inputs.inbox.message.copy()
    received[rows] = False
    slots = solid(message)
    slots[rows] = np.zeros((), dtype=slots.dtype)
    return replace(inputs, inbox=Inbox(received, message))


def _served(stopped: Bools, unserved: Bools, told: Bools | None) -> Bools:
    """Whose watchdog is served: of those that stand still, where the fault doesn't say otherwise."""
    return np.where(stopped, ~unserved, True if told is None else told)
