"""What programs hear and say, where faults lie, babble or damage messages."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np
from numpy.typing import NDArray

from bus.fault import Injected
from bus.lattice import Lattice
from cell_firmware.board import Board
from cell_firmware.controller import Controller, ControllerOutputs, ControllerState, Instant
from cell_firmware.effects.clock.wrapper import Clocked
from cell_firmware.effects.cop.wrapper import Watchdog
from cell_firmware.faults.base import CellFault, FaultAround
from cell_firmware.faults.execution import Outages, Slowed
from cell_firmware.faults.message_fault import Talk, Tamper
from cell_firmware.firmware import Floats, Inbox, Inputs, solid

Ints = NDArray[np.int64]


@final
class Words(FaultAround):
    """Lets faults change what cells hear and say; and has receivers refuse what no program says.

    A float that is no number, or infinite, is damage, and not handed over: a serial line's driver refuses it too. So is
    what the program says that no cell of it ever tells (``Program.credible``).

    It is inside of all else: what does not run neither hears nor says anything.
    """

    part = "words"
    beneath = (Clocked, Slowed, Watchdog, Outages)
    shown = ("refused",)

    def __init__(self, controller: Controller, lattice: Lattice, seed: int = 0, *, lag: int = 0) -> None:
        super().__init__(controller, lattice, seed, lag=lag)
        self._tampers: list[Tamper] = []
        board = controller if isinstance(controller, Board) else None
        self._links = None if board is None else board.links
        self._program = None if board is None else board.firmware

    def add(self, fault: Injected[CellFault]) -> None:
        """One more, from its first tick on."""
        super().add(fault)
        message = self.said
        assert message is not None, "this is a bug: words of programs that have none"
        tamper = fault.fault.tampers(Talk(self.lattice, self.seed, message, self._links), fault)
        if tamper is not None:
            self._tampers.append(tamper)

    def begin(self, inner: ControllerState, drive: Floats | None = None) -> ControllerState:
        """The state of cells that have heard nothing so far."""
        del drive
        n = len(inner.cells)
        own: dict[str, NDArray[np.generic]] = {
            "place": self.lattice.find(inner.cells.row, inner.cells.column),
            "refused": np.zeros(n, dtype=np.int64),
        }
        for tamper in self._tampers:
            own[_counts(tamper)] = np.zeros(n, dtype=np.int64)
            own.update({_named(tamper, name): array for name, array in tamper.begin(n).items()})
        return self.outer(inner, own)

    def after_reset(self, state: ControllerState, *, warm: bool = False) -> ControllerState:
        """What the cells' controller keeps of itself; faults know nothing of resets."""
        own = state.parts[self.part]
        return self.outer(self.controller.after_reset(self.inner(state), warm=warm), own)

    def listen(self, now: Instant, state: ControllerState, inputs: Inputs) -> tuple[ControllerState, Inputs]:
        """Whole messages, as faults left them."""
        inner, inputs = self.controller.listen(now, self.inner(state), inputs)
        own, inbox = dict(state.parts[self.part]), inputs.inbox
        assert inbox is not None, "this is a bug: no inbox, but messages to tamper with"
        for tamper in self._tampers:
            if not tamper.injected.acts(now.tick + self.lag):
                continue
            kept = tamper.begin(len(state.cells))
            kept = {name: own.get(_named(tamper, name), array) for name, array in kept.items()}
            kept, inbox, changed = tamper.hear(now.tick + self.lag, kept, own["place"], inbox)
            own.update({_named(tamper, name): array for name, array in kept.items()})
            own[_counts(tamper)] = own.get(_counts(tamper), 0) + changed
        inbox, refused = self._checked(inbox)
        own["refused"] = own["refused"] + refused
        return self.outer(inner, own), replace(inputs, inbox=inbox)

    def act(
        self, now: Instant, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """One control period, and what faults make of what is said in it."""
        own, tick = dict(state.parts[self.part]), now.tick + self.lag
        inner, outputs = self.controller.act(now, self.inner(state), inputs)
        for tamper in self._tampers:
            if tamper.injected.acts(tick):
                outbox, changed = tamper.say(now, tick, own["place"], outputs.outbox)
                outputs = replace(outputs, outbox=outbox)
                own[_counts(tamper)] = own.get(_counts(tamper), 0) + changed
        return self.outer(inner, own), outputs

    def idle(self, now: Instant, state: ControllerState) -> ControllerState:
        """What of the cells' controller goes on."""
        return self.outer(self.controller.idle(now, self.inner(state)), state.parts[self.part])

    def _checked(self, inbox: Inbox) -> tuple[Inbox, Ints]:
        """What receivers take, and how many messages each refuses."""
        assert self._program is not None, "this is a bug: words of no program"
        refused = inbox.received & ~self._program.credible(inbox.message)
        if not refused.any():
            return inbox, np.zeros(len(refused), dtype=np.int64)
        message = np.array(inbox.message)
        whole = solid(message)
        whole[refused] = np.zeros((), dtype=whole.dtype)
        return Inbox(inbox.received & ~refused, message), refused.sum(axis=1)

    def counted(self, state: ControllerState) -> dict[str, int]:
        """Messages that were refused, and those that were changed, by the kind of fault."""
        own, told = state.parts[self.part], dict[str, int]()
        for tamper in self._tampers:
            name = f"faults.{tamper.injected.fault.called}.{tamper.counts}"
            told[name] = told.get(name, 0) + int(np.sum(own.get(_counts(tamper), 0)))
        told["faults.words.refused"] = int(own["refused"].sum())
        return {**told, **super().counted(state)}


def _named(tamper: Tamper, name: str) -> str:
    return f"{tamper.injected.number}.{name}"


def _counts(tamper: Tamper) -> str:
    return _named(tamper, "counts")
