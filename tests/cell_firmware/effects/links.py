"""A firmware that sends the time of each message, and what its cells received."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultInstance
from bus.lattice import Lattice
from bus.partition import Partition
from cell_firmware.effects.registry import CellEffects
from cell_firmware.faults.base import CellFault
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import NoParameters

Ints = NDArray[np.int64]


class Stamper(Firmware):
    """Sends the tick on all sides, in every ``every``-th tick.

    Attributes:
        received: By tick, row and column, the tick of what was received on each side; −1 for nothing.
    """

    message = np.dtype([("said", "<i8")])
    speculative = False  # it writes down every step

    def __init__(self, every: int = 1) -> None:
        super().__init__(NoParameters())
        self.every = every
        self.received: dict[tuple[int, int, int], list[int]] = {}

    def init(self, cells: Cells) -> State:
        return {"tick": np.zeros(len(cells), dtype=np.int64), "row": cells.row, "column": cells.column}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        inbox = inputs.inbox
        assert inbox is not None
        assert not inbox.message["said"][~inbox.received].any(), "a slot without a message reads zero"
        received = np.where(inbox.received, inbox.message["said"], -1).tolist()
        names = zip(*(state[name].tolist() for name in ("tick", "row", "column")), strict=True)
        self.received.update(zip(names, received, strict=True))
        tick = state["tick"]
        message = np.zeros((len(tick), 4), dtype=self.message)
        message["said"] = tick[:, None]
        sent = np.repeat(tick[:, None] % self.every == 0, 4, axis=1)
        return {**state, "tick": tick + 1}, Outputs(np.zeros((len(tick), 2)), Outbox(sent, message))


def received_on(
    lattice: Lattice,
    run: Any,
    ticks: int,
    effects: CellEffects | None = None,
    every: int = 1,
    seed: int = 0,
    faults: Sequence[FaultInstance[CellFault]] = (),
    shards: int = 1,
) -> tuple[Ints, Counter[str]]:
    """The tick of what each link brought, ``(ticks, links)``, −1 for nothing; and what effects counted."""
    firmware = Stamper(every)
    partition = Partition.even(lattice, shards)
    counted = run(firmware, partition, ticks, effects=effects, seed=seed, faults=faults).counted
    received = [[firmware.received[tick, *cell] for cell in lattice.cells] for tick in range(ticks)]
    return np.array(received)[:, lattice.neighbours >= 0], counted
