"""What faults do to whole messages, behind the lines that carry them."""

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
    """How programs talk in a run.

    Attributes:
        lattice: Of the array.
        seed: Of the scene.
        message: Type of what programs say.
        links: What carries messages; None where they go over whole.
    """

    lattice: Lattice
    seed: int
    message: np.dtype[np.void]
    links: LinkDriver | None


class MessageFault(ABC):
    """What a fault does to whole messages after they came off the lines, or to what goes out on the lines.

    Args:
        injected: The fault.

    Attributes:
        injected: The fault.
    """

    counts: ClassVar[str]
    """What it counts of each cell."""

    def __init__(self, injected: FaultInstance[FaultSpec]) -> None:
        self.injected = injected

    def begin(self, cells: int) -> State:  # noqa: ARG002
        """What it remembers of cells before it has heard anything, arrays by name with a row a cell."""
        return {}

    def on_receive(self, tick: int, own: State, place: Ints, inbox: Inbox) -> tuple[State, Inbox, Ints]:  # noqa: ARG002
        """What programs hear instead.

        Args:
            tick: Of the exchange.
            own: What it remembers.
            place: ``(n,)``, the cells, by index into the lattice.
            inbox: Whole messages.

        Returns:
            What it remembers next; the messages; and of each cell how many it changed.
        """
        return own, inbox, np.zeros(len(place), dtype=np.int64)

    def on_send(
        self,
        now: StepTime,  # noqa: ARG002
        tick: int,  # noqa: ARG002
        place: Ints,
        outbox: Outbox | None,
    ) -> tuple[Outbox | None, Ints]:
        """What goes out instead, and how many messages of each cell that are its doing."""
        return outbox, np.zeros(len(place), dtype=np.int64)
