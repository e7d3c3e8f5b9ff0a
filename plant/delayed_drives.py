"""Drives between the tick whose senses they answer and the tick in which they act."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.lockstep.counters import Loss
from bus.state import StateFields
from plant.tick import Floats

Ints = NDArray[np.int64]


@final
class DelayedDrives:
    """Drives that act some ticks after the senses from which they were computed.

    A drive of a cell that died meanwhile is void, and stays so when the cell is repaired. A cell that is found lost
    counts as dead from the tick on in which the drive that is missing would have acted: which tick that is does not
    depend on how far the plant runs ahead of the cells.

    Args:
        cells: Number of cells in the array.
        ticks: ``sense_to_drive_ticks``, at least 1.

    Attributes:
        ticks: As given.
    """

    state_fields: ClassVar[StateFields] = StateFields(
        "_drives", "_losses", "_acts_ns", "_dead_at", records=(Loss,)
    )

    def __init__(self, cells: int, ticks: int) -> None:
        self.ticks = ticks
        self._losses: list[Sequence[Loss]] = []
        self._drives: list[Floats] = []
        self._acts_ns: list[Ints] = []
        self._dead_at: Ints = np.full(cells, -1, dtype=np.int64)
        """Last tick in which the cell was dead; -1: none."""

    def put(self, drives: Floats, losses: Sequence[Loss]) -> None:
        """Append the drives ``(n, 2)`` of the next tick of senses, and the losses found in it."""
        self._drives.append(drives)
        self._losses.append(losses)

    def mark_dead(self, dead: NDArray[np.bool_], tick: int) -> None:
        """Void what the cells marked in ``dead``, ``(n,)``, have computed up to ``tick``."""
        self._dead_at[dead] = tick

    def take(self, tick: int) -> tuple[Floats, Sequence[Loss]]:
        """Return the drives that act in ``tick``, zero in the first ticks, and the losses that are due."""
        sensed = tick - self.ticks
        if sensed < 0:
            return np.zeros((len(self._dead_at), 2)), ()
        drives, losses = self._drives.pop(0), self._losses.pop(0)
        void = self._dead_at >= sensed
        return (np.where(void[:, None], 0.0, drives) if void.any() else drives), losses

    def delay_instants(self, acts_ns: Ints, tick_ns: int) -> Ints:
        """Return when drives act in a tick, where cells have clocks of their own.

        Args:
            acts_ns: ``(n,)``, when they would act without delay, ns; negative: not in this tick.
            tick_ns: Length of a tick, ns.
        """
        self._acts_ns.append(acts_ns)
        if len(self._acts_ns) <= self.ticks:
            return np.full_like(acts_ns, -1)
        earlier = self._acts_ns.pop(0)
        return np.where(earlier < 0, earlier, earlier + self.ticks * tick_ns)

    @property
    def in_flight(self) -> Sequence[Loss]:
        """Losses whose drives would have acted later."""
        return [loss for losses in self._losses for loss in losses]
