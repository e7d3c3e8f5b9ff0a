"""What controllers around that of the cells have in common which carry out faults."""

from __future__ import annotations

from abc import abstractmethod
from typing import ClassVar

from bus.fault import Injected
from bus.lattice import Lattice
from cell_firmware.around import Around
from cell_firmware.controller import Controller, ControllerState
from cell_firmware.faults.fault import CellFault
from cell_firmware.firmware import Cells, Floats


class FaultAround(Around):
    """Base of what carries out faults around the cells' controller.

    Args:
        controller: Of the cells.
        lattice: Of the array.
        seed: The scene's.
        lag: By how many ticks an instant is older than the exchange in which its cells are stepped: 1 where cells have
            clocks of their own.

    Attributes:
        faults: What it carries out.
    """

    beneath: ClassVar[tuple[type[Around], ...]]
    """What goes around it."""

    def __init__(self, controller: Controller, lattice: Lattice, seed: int = 0, *, lag: int = 0) -> None:
        super().__init__(controller)
        self.lattice = lattice
        self.seed = seed
        self.lag = lag
        self.faults: list[Injected[CellFault]] = []

    def add(self, fault: Injected[CellFault]) -> None:
        """One more, from its first tick on."""
        self.faults.append(fault)

    def init(self, cells: Cells) -> ControllerState:
        """The state before tick 0."""
        return self.begin(self.controller.init(cells))

    @abstractmethod
    def begin(self, inner: ControllerState, drive: Floats | None = None) -> ControllerState:
        """The state of cells that no fault has struck so far.

        Args:
            inner: Their other parts.
            drive: ``(n, 2)``, what they drive; None: nothing yet.
        """
