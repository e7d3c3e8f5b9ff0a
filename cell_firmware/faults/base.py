"""Base classes of cell faults."""

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
from cell_firmware.firmware import Bools, Cells, Floats, Inputs, State

if TYPE_CHECKING:
    from cell_firmware.faults.message_fault import MessageContext, MessageFault
    from cell_firmware.specs import CellsSpec


@final
@dataclass(slots=True)
class ExecutionFaults:
    """Actions of faults on the programs of all cells of the array in a tick; each fault adds its own.

    Attributes:
        halted: ``(N,)``, whether the program is halted.
        outputs_held: ``(N,)``, whether the pins of a halted program are held; else wheels are commanded to 0.
        watchdog_unserved: ``(N,)``, whether the watchdog of a halted program is not served.
        reset: ``(N,)``, whether the program restarts in this tick, as after power-on.
    """

    halted: Bools
    outputs_held: Bools
    watchdog_unserved: Bools
    reset: Bools

    @staticmethod
    def none(cells: int) -> ExecutionFaults:
        """Return a record without any action."""
        return ExecutionFaults(*(np.zeros(cells, dtype=np.bool_) for _ in range(4)))


class CellFault(FaultSpec):
    """A fault of cells: acts on their inputs, by filters that follow the effects' filters, or on their programs."""

    halts_program: ClassVar[bool] = False
    """Whether the fault halts or resets programs (``execution``)."""
    skips_periods: ClassVar[bool] = False
    """Whether programs skip some of their control periods (``running_periods``)."""
    corrupts_messages: ClassVar[bool] = False
    """Whether the fault can produce messages that no program sends, so that receivers must check messages."""

    def input_filters(
        self,
        site: ShardContext,  # noqa: ARG002
        lattice: Lattice,  # noqa: ARG002
        injected: FaultInstance[CellFault],  # noqa: ARG002
    ) -> Iterator[FaultFilter]:
        """Yield the input filters of a shard's cells; none where no cell of the shard is affected.

        Args:
            site: The shard's cells.
            lattice: Of the array.
            injected: This fault, with its number, cells and times.
        """
        yield from ()

    def execution(self, tick: int, injected: FaultInstance[CellFault], pause: ExecutionFaults) -> None:
        """Add the fault's actions on programs in a tick; the fault may be inactive, as a repair acts at its end tick.

        Args:
            tick: The tick.
            injected: This fault, with its number, cells and times.
            pause: Actions in the tick, changed in place.
        """

    def running_periods(self, period: NDArray[np.int64]) -> Bools:
        """Return in which control periods, counted from the fault's start, an affected program runs."""
        return np.ones(period.shape, dtype=np.bool_)

    def message_faults(self, talk: MessageContext, injected: FaultInstance[CellFault]) -> MessageFault | None:  # noqa: ARG002
        """Return the fault's changes to whole messages, received or sent; None if there are none.

        Args:
            talk: How programs talk.
            injected: This fault, with its number, cells and times.
        """
        return None

    def fit_problems(self, cells: CellsSpec, sensors: int) -> Iterator[Problem]:  # noqa: ARG002
        """Yield settings of the fault that do not fit the cells.

        Args:
            cells: The scene's settings of cells.
            sensors: Number of presence sensors of a cell.
        """
        yield from ()


class FaultFilter(InputFilter):
    """An input filter that is active while its fault is; counters are named by the fault's kind.

    Args:
        injected: The fault.
        counts: Names of the filter's counters.
        lingers: Ticks after the fault's end during which messages may be left to deliver.
    """

    def __init__(self, injected: FaultInstance[CellFault], *counts: str, lingers: int = 0) -> None:
        super().__init__()
        self._injected = injected
        self._lingers = lingers
        self.counters.update(dict.fromkeys((self._named(name) for name in counts), 0))

    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Filter the inputs while the fault is active or has messages left to deliver."""
        return self.apply_active(tick, inputs, alive) if self.acts_at(tick) else inputs

    def acts_at(self, tick: int) -> bool:
        """Whether the fault is active in a tick or has messages left to deliver."""
        return self._injected.start_tick <= tick < self._injected.end_tick + self._lingers

    @abstractmethod
    def apply_active(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Filter the inputs; see ``InputFilter.apply``."""

    def count(self, name: str, happened: Bools, alive: NDArray[np.int64] | slice) -> None:
        """Count events: true values of ``happened``, ``(n, ...)``, in live cells."""
        super().count(self._named(name), happened, alive)

    def _named(self, name: str) -> str:
        return f"{self._injected.fault.kind_name}.{name}"


def stream_name(injected: FaultInstance[CellFault], what: str = "") -> str:
    """Name the random stream of a fault; no two faults of a scene share a stream."""
    return f"faults.{injected.number}.{injected.fault.kind_name}{what}"


class FaultWrapper(ControllerWrapper):
    """Base of wrappers that carry out faults around the cells' controller.

    Args:
        controller: Controller of the cells.
        lattice: Lattice of the array.
        seed: Seed of the scene.
        lag: Age of an instant in the exchange in which its cells are stepped, ticks: 1 where cells have their own
            clocks.
        link_ticks: Ticks after which a message is read.

    Attributes:
        faults: Faults that the wrapper carries out.
    """

    def __init__(
        self, controller: Controller, lattice: Lattice, seed: int = 0, *, lag: int = 0, link_ticks: int = 1
    ) -> None:
        super().__init__(controller)
        self.link_ticks = link_ticks
        self.lattice = lattice
        self.seed = seed
        self.start_tick = lag
        self.faults: list[FaultInstance[CellFault]] = []

    def add(self, fault: FaultInstance[CellFault]) -> None:
        """Add a fault, effective from its start tick."""
        self.faults.append(fault)

    def init(self, cells: Cells) -> ControllerState:
        """The state before tick 0."""
        return self.begin(self.controller.init(cells))

    @abstractmethod
    def begin(self, inner: ControllerState, drive: Floats | None = None) -> ControllerState:
        """Return the state of cells that no fault has affected so far.

        Args:
            inner: State of the wrapped controller.
            drive: ``(n, 2)``, current drives; None: no drives yet.
        """

    def acts_at(self, tick: int, cells: NDArray[np.int64]) -> bool:
        """Whether a fault acts on cells in a tick, or its repair does.

        Args:
            tick: The tick.
            cells: The cells, by index into the lattice.
        """
        return any(
            (fault.active_at(tick) or tick == fault.end_tick) and self.affects(fault, cells)
            for fault in self.faults
        )

    def affects(self, fault: FaultInstance[CellFault], cells: NDArray[np.int64]) -> bool:
        """Whether the wrapper does anything to these cells while a fault is active; see ``acts_at``."""
        return bool(np.isin(fault.cells, cells).any())

    def is_settled(self, tick: int, own: State) -> bool:  # noqa: ARG002
        """Whether no fault that is over has an effect in a tick or later: the wrapper can be left out from then on.

        Args:
            tick: The tick.
            own: State of the wrapper before it.
        """
        return True

    def catch_up(self, own: State, drive: Floats) -> State:  # noqa: ARG002
        """Return the wrapper's state after ticks in which it was left out.

        Args:
            own: State before them.
            drive: ``(n, 2)``, current drives.
        """
        return own
