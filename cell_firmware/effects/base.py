"""Base classes of cell effects: specifications, and filters between the bus and the firmware."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.effect import EffectSpec
from bus.lattice import SIDES
from bus.state import StateFields
from cell_firmware.clocks import NOT_IN_WINDOW, CellClocks
from cell_firmware.firmware import Bools, Inputs
from cell_firmware.specs import CellsSpec


@final
@dataclass(frozen=True, slots=True, eq=False)
class ShardContext:
    """The cells of one shard, as far as effects are concerned.

    Attributes:
        cells: ``(n,)`` int64, the shard's cells by index into the lattice.
        sensors: Presence sensors of a cell.
        message: Type of a message between neighbours; None without messages.
        seed: Seed of the scene.
        levels: Whether sensors have levels.
        said: Type of the programs' messages, which ``message`` carries; None: the same type.
        tick_ns: Time from one exchange to the next, ns.
        clocks: The cells' clocks, which define the exchanges in which a cell has a new reading; None: all exchanges.
    """

    cells: NDArray[np.int64]
    sensors: int
    message: np.dtype[Any] | None
    seed: int
    levels: bool = False
    said: np.dtype[Any] | None = None
    tick_ns: int = 0
    clocks: CellClocks | None = None

    def fresh(self, tick: int) -> Bools | None:
        """Return the cells with a new reading in an exchange, ``(n,)``; None: all.

        The inputs of the other cells are their last readings.
        """
        return None if self.clocks is None else self.clocks.instants(tick - 1) != NOT_IN_WINDOW

    def sensor_stream_ids(self) -> NDArray[np.int64]:
        """Return an identifier for every sensor, ``(n sensors,)``, unique in the whole array."""
        return stream_ids(self.cells, self.sensors)

    def link_stream_ids(self) -> NDArray[np.int64]:
        """Return an identifier for every side of every cell, ``(4 n,)``, unique in the whole array."""
        return stream_ids(self.cells, len(SIDES))


def stream_ids(whose: NDArray[np.int64], each: int) -> NDArray[np.int64]:
    """Numbers, ``each`` of them for every one of ``whose`` numbers, ``(each m,)``, no two alike."""
    return (each * whose[:, None] + np.arange(each)).ravel()


class InputFilter(ABC):
    """Filter of the inputs of a shard's cells: applied once a tick, in order of ticks, before the firmware.

    Attributes:
        counters: Events in live cells so far, by name.
    """

    state_fields: ClassVar[StateFields] = StateFields("counters")

    def __init__(self) -> None:
        self.counters: Counter[str] = Counter()

    @abstractmethod
    def apply(self, tick: int, inputs: Inputs, alive: NDArray[np.int64] | slice) -> Inputs:
        """Filter the inputs of a tick.

        Args:
            tick: The tick.
            inputs: Of all n cells of the shard, dead ones too. The inbox may be written to.
            alive: Rows of live cells. Inputs of dead cells are not used, and their events are not counted.
        """

    def count(self, name: str, happened: Bools, alive: NDArray[np.int64] | slice) -> None:
        """Count events: true values of ``happened``, ``(n, ...)``, in live cells."""
        self.counters[name] += int(np.count_nonzero(happened[alive]))


class CellEffectSpec(EffectSpec):
    """An effect of the cells, assembled once, when a shard is built.

    An effect either filters the inputs of cells or is a part of their board: see ``cell_firmware.build``.
    """

    def input_filters(self, site: ShardContext) -> Iterator[InputFilter]:  # noqa: ARG002
        """Yield the filters of the shard's inputs, in order; none where the settings have no effect."""
        yield from ()

    def fit_problems(
        self,
        cells: CellsSpec,  # noqa: ARG002
    ) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """Yield settings that do not fit the cells: path from the effect's table, value, and violated rule."""
        yield from ()
