"""Faults that are injected into a lab between two ticks."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultInstance, FaultSpec
from bus.lattice import NO_TICK_LIMIT, Lattice
from deploy.errors import InputError
from deploy.lab.faults import checked_fault, seconds
from deploy.lab.tables import CellName, index_of
from deploy.scenes.fault_schedule import halted_cells, in_run_faults

if TYPE_CHECKING:
    from deploy.lab.cells import LabCells
    from deploy.scenes.scene import Scene


class FaultInjection:
    """Part of a lab that injects faults.

    Attributes:
        lattice: The cells.
    """

    lattice: Lattice
    _scene: Scene
    _cells: LabCells
    _injected: list[FaultInstance[FaultSpec]]

    @property
    def tick(self) -> int:
        """The next tick."""
        return self._cells.tick

    @property
    def alive(self) -> tuple[CellName, ...]:
        """``(row, column)`` of the cells whose programs run in the next tick."""
        halted = self._halted(self.tick)
        return tuple(cell for cell in self._cells.shard.alive if not halted[self.lattice.index(cell)])

    def inject(self, kind: str, for_ticks: int | None = None, **keys: Any) -> int:
        """Inject a fault that begins with the next tick.

        Args:
            kind: Kind of the fault, as in a scene.
            for_ticks: Duration; None: until it is repaired.
            keys: The other keys of the fault, without times.

        Returns:
            Number of the fault, for ``end_fault``.

        Raises:
            InputError: The fault is refused.
        """
        if for_ticks is not None and for_ticks < 1:
            raise InputError(f"for_ticks {for_ticks}: must be at least 1")
        start = self.tick
        end = NO_TICK_LIMIT if for_ticks is None else start + for_ticks
        number = len(self._scene.faults) + len(self._injected)
        table = {"kind": kind, "at_s": self._seconds(start), **keys}
        fault = checked_fault(table, self._scene)
        first, last = fault.tick_range(self._scene.tick_at)
        one = FaultInstance(
            number,
            fault,
            fault.affected_cells(self.lattice, self._scene.seed, number),
            first,
            last if not fault.repairable else end,
            injected_at_runtime=True,
        )
        self._cells.inject(one)
        self._injected.append(one)
        return number

    def end_fault(self, number: int) -> None:
        """Repair an injected fault before the next tick.

        Raises:
            InputError: There is no such fault, or it has ended.
        """
        for one in self._injected:
            if one.number == number and one.end_tick > self.tick:
                one.end_tick = self.tick
                self._cells.replan()
                return
        raise InputError(f"fault {number}: no injected fault of this number acts")

    def kill(self, *cells: CellName) -> None:
        """Kill cells: from the next tick on their programs don't run, and send nothing; ``repair`` revives them."""
        for cell in cells:
            self._index(cell)
            self.inject("crash", cell=list(cell))

    def repair(self, *cells: CellName) -> None:
        """Revive killed cells: in the next tick their programs start as after power-on.

        Raises:
            InputError: A cell wasn't killed.
        """
        for cell in cells:
            index = self._index(cell)
            acting = [
                one.number
                for one in self._injected
                if one.fault.kind_name == "crash" and index in one.cells and one.end_tick > self.tick
            ]
            if not acting:
                raise InputError(f"cell {cell[0]},{cell[1]}: wasn't killed, so it can't be repaired")
            for number in acting:
                self.end_fault(number)

    def reboot(self, *cells: CellName, ticks: int = 1) -> None:
        """Restart programs as after power-on, after so many ticks without running."""
        for cell in cells:
            self._index(cell)
            self.inject("reboot", cell=list(cell), delay_s=self._seconds(ticks))

    def lose(self, cell: CellName, side: str, ticks: int = 1) -> None:
        """Lose the messages that a cell would read from a side in the next ticks."""
        self.inject("link_down", ticks, cell=list(cell), side=side, direction="in")

    def delay(self, cell: CellName, side: str, by: int, ticks: int = 1) -> None:
        """Have the messages that a cell would read from a side in the next ticks come ``by`` ticks later."""
        self.inject("link_delay", ticks, cell=list(cell), side=side, direction="in", ticks=by)

    def duplicate(self, cell: CellName, side: str, ticks: int = 1) -> None:
        """Have the messages that a cell reads from a side in the next ticks come again a tick later."""
        self.inject("link_duplicate", ticks, cell=list(cell), side=side, direction="in", probability=1.0)

    def cut(self, cell: CellName, side: str, ticks: int | None = None) -> int:
        """Cut a link both ways; returns the number of the fault."""
        return self.inject("link_down", ticks, cell=list(cell), side=side)

    # --- helpers -----------------------------------------------------------------------------------

    def _index(self, cell: object) -> int:
        return index_of(self.lattice, cell)

    def _seconds(self, tick: int) -> float:
        return seconds(tick, self._scene.tick_ns)

    def _faults(self) -> tuple[FaultInstance[FaultSpec], ...]:
        return (*in_run_faults(self._scene), *self._injected)

    def _halted(self, tick: int) -> NDArray[np.bool_]:
        return halted_cells(self._faults(), tick, len(self.lattice))
