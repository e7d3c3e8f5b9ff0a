"""Faults of a shard: its cells are stepped without the wrappers of those that act on other cells alone."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.controller import Controller, ControllerState
from cell_firmware.firmware import Floats

if TYPE_CHECKING:
    from bus.fault import FaultInstance
    from bus.lattice import Lattice
    from cell_firmware.faults.base import CellFault


@final
class ShardFaults:
    """Faults of a run, as one shard has them.

    A controller with a fault's wrappers has no compiled form. So only a shard on whose cells a fault acts steps them
    with its wrappers; in the others these would change nothing. Registers and counters are those of all wrappers
    everywhere.

    Args:
        controller: Controller with the wrappers of all faults.
        faults: The faults.
        cells: ``(n,)``, the shard's cells, by index into the lattice.

    Attributes:
        stepped: Controller to step the cells with.
    """

    def __init__(
        self, controller: Controller, faults: Iterable[FaultInstance[CellFault]], cells: NDArray[np.int64]
    ) -> None:
        self._faults = {one.number: one for one in faults}
        self._cells = cells
        self._talks = controller.message_type is not None
        self._whole = self.stepped = controller
        if self._faults and not self._acts(self._faults.values()):
            from cell_firmware.faults.attach import without_faults

            self.stepped = without_faults(controller)

    def _acts(self, faults: Iterable[FaultInstance[Any]]) -> bool:
        from cell_firmware.faults.attach import acts_on

        return any(acts_on(fault, self._cells, talks=self._talks) for fault in faults)

    def inject(
        self, fault: FaultInstance[CellFault], lattice: Lattice, seed: int, *, link_ticks: int
    ) -> bool:
        """Inject a fault.

        Args:
            fault: The fault.
            lattice: Lattice of the array.
            seed: The scene's.
            link_ticks: Ticks after which a message is read.

        Returns:
            Whether ``stepped`` is another controller now, which takes a state from ``shown``.
        """
        from cell_firmware.faults.attach import attach_fault, without_faults

        self._faults[fault.number] = fault
        if not self.apart and not self._acts(self._faults.values()):
            self._whole = without_faults(self._whole)  # the other one stays as it is
        self._whole = attach_fault(self._whole, lattice, seed, fault, link_ticks=link_ticks)
        if not self._acts((fault,)):
            return False
        self.stepped = self._whole
        return True

    def repair(self, number: int, tick: int) -> None:
        """End a fault at ``tick``; an unknown fault is ignored."""
        if number in self._faults:
            self._faults[number].end_tick = tick

    def shown(self, state: ControllerState, drive: Floats) -> tuple[Controller, ControllerState]:
        """Return the controller with all wrappers, and a state of it.

        Args:
            state: Of n cells, as the controller has it that is stepped.
            drive: ``(n, 2)``, their current drives.
        """
        from cell_firmware.faults.attach import init_new_wrappers

        return self._whole, init_new_wrappers(self._whole, state, drive)

    @property
    def apart(self) -> bool:
        """Whether the controller that is stepped lacks wrappers."""
        return self.stepped is not self._whole
