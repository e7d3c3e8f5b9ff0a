"""What faults of cells are made of."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultSpec, Injected, Problem
from bus.lattice import Lattice
from cell_firmware.controller import Around, Controller, ControllerState
from cell_firmware.effects.base import Site, Stage
from cell_firmware.firmware import Bools, Cells, Floats, Inputs

if TYPE_CHECKING:
    from cell_firmware.faults.message_fault import Talk, Tamper
    from cell_firmware.specs import CellsSpec


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
    """A fault of cells: it acts on what they see, as stages after those of the effects, or on their programs."""

    pauses: ClassVar[bool] = False
    """Whether it stops programs or lets them begin anew (``pause``)."""
    slows: ClassVar[bool] = False
    """Whether it keeps programs from running in some of their periods (``runs``)."""
    damages: ClassVar[bool] = False
    """Whether messages may come of it that no program sends, so that receivers have to look what they take."""

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

    def runs(self, period: NDArray[np.int64]) -> Bools:
        """In which control periods, counted from when it began, a program runs that it slows."""
        return np.ones(period.shape, dtype=np.bool_)

    def tampers(self, talk: Talk, injected: Injected[CellFault]) -> Tamper | None:  # noqa: ARG002
        """What it does to whole messages, as they are heard or said; None: nothing.

        Args:
            talk: How programs talk.
            injected: This fault, with its number, cells and times.
        """
        return None

    def unfit(self, cells: CellsSpec, sensors: int) -> Iterator[Problem]:  # noqa: ARG002
        """What of it does not fit the cells.

        Args:
            cells: What the scene says of them.
            sensors: How many presence sensors each has.
        """
        yield from ()


class FaultStage(Stage):
    """A stage that acts while its fault does. What it counts is told by the fault's kind.

    Args:
        injected: The fault.
        counts: Names of what it counts.
        lingers: For how many ticks after its end the fault may still have something to hand over.
    """

    def __init__(self, injected: Injected[CellFault], *counts: str, lingers: int = 0) -> None:
        super().__init__()
        self._injected = injected
        self._lingers = lingers
        self.counted.update(dict.fromkeys((self._named(name) for name in counts), 0))

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """What the cells see instead, while the fault acts or has something left to hand over."""
        if self._injected.first <= tick < self._injected.end + self._lingers:
            return self.strike(tick, inputs, alive)
        return inputs

    @abstractmethod
    def strike(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """What the cells see instead; see ``Stage.apply``."""

    def count(self, name: str, happened: Bools, alive: NDArray[np.int64] | slice) -> None:
        """Counts what ``happened``, ``(n, ...)``, to cells that live."""
        super().count(self._named(name), happened, alive)

    def _named(self, name: str) -> str:
        return f"{self._injected.fault.called}.{name}"


def purpose(injected: Injected[CellFault], what: str = "") -> str:
    """What a fault's draws are named after: no two faults of a scene draw the same numbers."""
    return f"faults.{injected.number}.{injected.fault.called}{what}"


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
