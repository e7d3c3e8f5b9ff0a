"""What faults of cells are made of."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultSpec, Injected
from bus.lattice import Lattice
from cell_firmware.effects.stage import Site, Stage
from cell_firmware.firmware import Bools, Inputs


@final
@dataclass(slots=True)
class Pause:
    """What faults do to the programs of all cells of the array in a tick; each fault adds its own.

    Attributes:
        stopped: ``(N,)``: does the program stand still?
        keeps: ``(N,)``: of those that do, do the pins keep what they had? Else wheels are commanded to 0.
        unserved: ``(N,)``: of those, does nobody serve the watchdog?
        reset: ``(N,)``: does the program begin anew in this tick, as after power-on?
    """

    stopped: Bools
    keeps: Bools
    unserved: Bools
    reset: Bools

    @staticmethod
    def none(cells: int) -> Pause:
        """Nothing happens to any of them."""
        return Pause(*(np.zeros(cells, dtype=np.bool_) for _ in range(4)))


class CellFault(FaultSpec):
    """A fault of cells: it acts on what they see, as stages after those of the effects, or it stops their programs."""

    pauses: ClassVar[bool] = False
    """Whether it acts on programs."""

    def stages(self, site: Site, lattice: Lattice, injected: Injected[CellFault]) -> Iterator[FaultStage]:  # noqa: ARG002
        """What the inputs of a shard's cells have to pass; nothing where none of its cells is struck.

        Args:
            site: The shard's cells.
            lattice: Of the array.
            injected: This fault, with its number, cells and times.
        """
        yield from ()

    def pause(self, tick: int, injected: Injected[CellFault], pause: Pause) -> None:
        """Say what becomes of programs in a tick, in which it need not act: a repair is of the tick after.

        Args:
            tick: Which.
            injected: This fault, with its number, cells and times.
            pause: To be changed.
        """


class FaultStage(Stage):
    """A stage that acts while its fault does.

    Args:
        injected: The fault.
    """

    def __init__(self, injected: Injected[CellFault]) -> None:
        super().__init__()
        self._injected = injected

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """What the cells see instead, while the fault acts."""
        return self.strike(tick, inputs, alive) if self._injected.acts(tick) else inputs

    def strike(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """What the cells see instead; see ``Stage.apply``."""
        raise NotImplementedError
