"""Wrapper for faults that corrupt messages, and refusal of implausible messages at receivers."""

from __future__ import annotations

from dataclasses import replace
from typing import final

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultInstance
from bus.lattice import Lattice
from cell_firmware.board import Board
from cell_firmware.controller import Controller, ControllerOutputs, ControllerState, StepTime
from cell_firmware.faults.base import CellFault, FaultWrapper
from cell_firmware.faults.message_fault import MessageContext, MessageFault
from cell_firmware.firmware import Floats, Inputs
from cell_firmware.refusals import REFUSALS, REFUSED, refuse

Ints = NDArray[np.int64]


@final
class MessageFaultWrapper(FaultWrapper):
    """Wrapper that applies message faults on receive and on send, and drops implausible received messages.

    A NaN or infinite float counts as damage and is not delivered, as with a serial line's driver. A message that no
    cell of the program could have sent (``Program.accepts``) is refused as well.

    Innermost wrapper: a halted program neither receives nor sends.
    """

    part = REFUSALS
    shown = (REFUSED,)

    def __init__(
        self, controller: Controller, lattice: Lattice, seed: int = 0, *, lag: int = 0, link_ticks: int = 1
    ) -> None:
        super().__init__(controller, lattice, seed, lag=lag, link_ticks=link_ticks)
        self._tampers: list[MessageFault] = []
        board = controller if isinstance(controller, Board) else None
        self._links = None if board is None else board.links
        self._program = None if board is None else board.firmware

    def add(self, fault: FaultInstance[CellFault]) -> None:
        """Add a fault, effective from its start tick."""
        super().add(fault)
        message = self.message_type
        assert message is not None, "this is a bug: words of programs that have none"
        tamper = fault.fault.message_faults(
            MessageContext(self.lattice, self.seed, message, self._links), fault
        )
        if tamper is not None:
            self._tampers.append(tamper)

    def begin(self, inner: ControllerState, drive: Floats | None = None) -> ControllerState:
        """Return the state of cells without received messages so far."""
        del drive
        n = len(inner.cells)
        own: dict[str, NDArray[np.generic]] = {
            "place": self.lattice.find(inner.cells.row, inner.cells.column),
            REFUSED: np.zeros(n, dtype=np.int64),
        }
        for tamper in self._tampers:
            own[_counts(tamper)] = np.zeros(n, dtype=np.int64)
            own.update({_named(tamper, name): array for name, array in tamper.begin(n).items()})
        return self.wrap_state(inner, own)

    def reset(self, state: ControllerState, *, warm: bool = False) -> ControllerState:
        """Reset the wrapped controller; the state of faults is retained."""
        own = state.parts[self.part]
        return self.wrap_state(self.controller.reset(self.unwrap_state(state), warm=warm), own)

    def receive(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, Inputs]:
        """Receive whole messages, apply active faults, and refuse implausible messages."""
        inner, inputs = self.controller.receive(now, self.unwrap_state(state), inputs)
        own, inbox = dict(state.parts[self.part]), inputs.inbox
        assert inbox is not None, "this is a bug: no inbox, but messages to tamper with"
        for tamper in self._tampers:
            if not tamper.injected.active_at(now.tick + self.start_tick):
                continue
            memory = tamper.begin(len(state.cells))
            memory = {name: own.get(_named(tamper, name), array) for name, array in memory.items()}
            memory, inbox, changed = tamper.on_receive(
                now.tick + self.start_tick, memory, own["place"], inbox
            )
            own.update({_named(tamper, name): array for name, array in memory.items()})
            own[_counts(tamper)] = own.get(_counts(tamper), 0) + changed
        assert self._program is not None, "this is a bug: words of no program"
        inbox, refused = refuse(self._program, inbox)
        own[REFUSED] = own[REFUSED] + refused
        return self.wrap_state(inner, own), replace(inputs, inbox=inbox)

    def compute(
        self, now: StepTime, state: ControllerState, inputs: Inputs
    ) -> tuple[ControllerState, ControllerOutputs]:
        """Compute a control period, and apply active faults to sent messages."""
        own, tick = dict(state.parts[self.part]), now.tick + self.start_tick
        inner, outputs = self.controller.compute(now, self.unwrap_state(state), inputs)
        for tamper in self._tampers:
            if tamper.injected.active_at(tick):
                outbox, changed = tamper.on_send(now, tick, own["place"], outputs.outbox)
                outputs = replace(outputs, outbox=outbox)
                own[_counts(tamper)] = own.get(_counts(tamper), 0) + changed
        return self.wrap_state(inner, own), outputs

    def affects(self, fault: FaultInstance[CellFault], cells: Ints) -> bool:
        """Whether a fault changes messages of these cells; refusals need no wrapper."""
        return any(one.injected is fault and np.isin(one.cells, cells).any() for one in self._tampers)

    def counters(self, state: ControllerState) -> dict[str, int]:
        """Return the numbers of refused messages, and of changed messages by kind of fault."""
        own, counters = state.parts[self.part], dict[str, int]()
        for tamper in self._tampers:
            name = f"faults.{tamper.injected.fault.kind_name}.{tamper.counts}"
            counters[name] = counters.get(name, 0) + int(np.sum(own.get(_counts(tamper), 0)))
        counters[f"faults.{self.part}.{REFUSED}"] = int(own[REFUSED].sum())
        return {**counters, **super().counters(state)}


def _named(tamper: MessageFault, name: str) -> str:
    return f"{tamper.injected.number}.{name}"


def _counts(tamper: MessageFault) -> str:
    return _named(tamper, "counts")
