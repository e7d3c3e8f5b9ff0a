"""Interface of faults that act on whole messages, beyond the lines."""

from __future__ import annotations

from abc import ABC
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultInstance, FaultSpec
from bus.lattice import Lattice
from cell_firmware.firmware import Inbox, Outbox, State

if TYPE_CHECKING:
    from cell_firmware.components import LinkDriver
    from cell_firmware.controller import StepTime

Ints = NDArray[np.int64]


@final
@dataclass(frozen=True, slots=True, eq=False)
class MessageContext:
    """Messages and links of a run.

    Attributes:
        lattice: Of the array.
        seed: Of the scene.
        message: Type of the programs' messages.
        links: Driver of the links; None where links deliver whole messages.
    """

    lattice: Lattice
    seed: int
    message: np.dtype[np.void]
    links: LinkDriver | None


class MessageFault(ABC):
    """Changes of a fault to whole messages received from the lines, or to payloads sent on the lines.

    Args:
        injected: The fault.
        cells: Cells of which it changes messages, by index into the lattice.

    Attributes:
        injected: The fault.
        cells: Cells of which it changes messages, by index into the lattice.
    """

    counts: ClassVar[str]
    """Name of the counter of changed messages."""

    def __init__(self, injected: FaultInstance[FaultSpec], cells: Ints) -> None:
        self.injected = injected
        self.cells = cells

    def begin(self, cells: int) -> State:  # noqa: ARG002
        """Return the initial state: arrays by name, with a row a cell."""
        return {}

    def on_receive(self, tick: int, own: State, place: Ints, inbox: Inbox) -> tuple[State, Inbox, Ints]:  # noqa: ARG002
        """Change received messages.

        Args:
            tick: Of the exchange.
            own: State of the fault.
            place: ``(n,)``, the cells, by index into the lattice.
            inbox: Whole messages.

        Returns:
            The next state, the messages, and the number changed for each cell.
        """
        return own, inbox, np.zeros(len(place), dtype=np.int64)

    def on_send(
        self,
        now: StepTime,  # noqa: ARG002
        tick: int,  # noqa: ARG002
        place: Ints,
        outbox: Outbox | None,
    ) -> tuple[Outbox | None, Ints]:
        """Change sent payloads; return the payloads, and the number changed for each cell."""
        return outbox, np.zeros(len(place), dtype=np.int64)
