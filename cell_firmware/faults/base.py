"""What faults of cells are made of."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultInstance, FaultSpec, Problem
from bus.lattice import Lattice
from cell_firmware.controller import Controller, ControllerState, ControllerWrapper
from cell_firmware.effects.base import InputFilter, ShardContext
from cell_firmware.firmware import Bools, Cells, Floats, Inputs

if TYPE_CHECKING:
    from cell_firmware.faults.message_fault import MessageContext, MessageFault
    from cell_firmware.specs import CellsSpec


@final
@dataclass(slots=True)
class ExecutionFaults:
    """What faults do to the programs of all cells of the array in a tick; each fault adds its own.

    Attributes:
        stopped: ``(N,)``: does the program stand still?
        keeps: ``(N,)``: of those that do, do the pins keep what they had? Else wheels are commanded to 0.
        unserved: ``(N,)``: of those, does nobody serve the watchdog?
        reset: ``(N,)``: does the program begin anew in this tick, as after power-on?
    """

    halted: Bools
    outputs_held: Bools
    watchdog_unserved: Bools
    reset: Bools

    @staticmethod
    def none(cells: int) -> ExecutionFaults:
        """Nothing happens to any of them."""
        return ExecutionFaults(*(np.zeros(cells, dtype=np.bool_) for _ in range(4)))


class CellFault(FaultSpec):
    """A fault of cells: it acts on what they see, as stages after those of the effects, or on their programs."""

    halts_program: ClassVar[bool] = False
    """Whether it stops programs or lets them begin anew (``pause``)."""
    skips_periods: ClassVar[bool] = False
    """Whether it keeps programs from running in some of their periods (``runs``)."""
    corrupts_messages: ClassVar[bool] = False
    """Whether messages may come of it that no program sends, so that receivers have to look what they take."""

    def input_filters(
        self,
        site: ShardContext,  # noqa: ARG002
        lattice: Lattice,  # noqa: ARG002
        injected: FaultInstance[CellFault],  # noqa: ARG002
    ) -> Iterator[FaultFilter]:
        """What the inputs of a shard's cells have to pass; nothing where none of its cells is struck.

        Args:
            site: The shard's cells.
            lattice: Of the array.
            injected: This fault, with its number, cells and times.
        """
        yield from ()

    def execution(self, tick: int, injected: FaultInstance[CellFault], pause: ExecutionFaults) -> None:
        """Say what becomes of programs in a tick, in which it need not act: a repair is of the tick after.

        Args:
            tick: Which.
            injected: This fault, with its number, cells and times.
            pause: To be changed.
        """

    def running_periods(self, period: NDArray[np.int64]) -> Bools:
        """In which control periods, counted from when it began, a program runs that it slows."""
        return np.ones(period.shape, dtype=np.bool_)

    def message_faults(self, talk: MessageContext, injected: FaultInstance[CellFault]) -> MessageFault | None:  # noqa: ARG002
        """What it does to whole messages, as they are heard or said; None: nothing.

        Args:
            talk: How programs talk.
            injected: This fault, with its number, cells and times.
        """
        return None

    def fit_problems(self, cells: CellsSpec, sensors: int) -> Iterator[Problem]:  # noqa: ARG002
        """What of it does not fit the cells.

        Args:
            cells: What the scene says of them.
            sensors: How many presence sensors each has.
        """
        yield from ()


class FaultFilter(InputFilter):
    """A stage that acts while its fault does. What it counts is told by the fault's kind.

    Args:
        injected: The fault.
        counts: Names of what it counts.
        lingers: For how many ticks after its end the fault may still have something to hand over.
    """

    def __init__(self, injected: FaultInstance[CellFault], *counts: str, lingers: int = 0) -> None:
        super().__init__()
        self._injected = injected
        self._lingers = lingers
        self.counters.update(dict.fromkeys((self._named(name) for name in counts), 0))

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """What the cells see instead, while the fault acts or has something left to hand over."""
        if self._injected.start_tick <= tick < self._injected.end_tick + self._lingers:
            return self.apply_active(tick, inputs, alive)
        return inputs

    @abstractmethod
    def apply_active(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """What the cells see instead; see ``InputFilter.apply``."""

    def count(self, name: str, happened: Bools, alive: NDArray[np.int64] | slice) -> None:
        """Counts what ``happened``, ``(n, ...)``, to cells that live."""
        super().count(self._named(name), happened, alive)

    def _named(self, name: str) -> str:
        return f"{self._injected.fault.kind_name}.{name}"


def stream_name(injected: FaultInstance[CellFault], what: str = "") -> str:
    """What a fault's draws are named after: no two faults of a scene draw the same numbers."""
    return f"faults.{injected.number}.{injected.fault.kind_name}{what}"


class FaultWrapper(ControllerWrapper):
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

    beneath: ClassVar[tuple[type[ControllerWrapper], ...]]
    """What goes around it."""

    def __init__(self, controller: Controller, lattice: Lattice, seed: int = 0, *, lag: int = 0) -> None:
        super().__init__(controller)
        self.lattice = lattice
        self.seed = seed
        self.start_tick = lag
        self.faults: list[FaultInstance[CellFault]] = []

    def add(self, fault: FaultInstance[CellFault]) -> None:
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
