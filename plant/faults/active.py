"""The faults of a run that act on the plant, begun and ended at ticks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import final

from bus.fault import Injected, turns
from bus.lives import NEVER
from plant.faults.fault import Harm, PlantFault


@final
class ActiveFaults:
    """Says in which ticks something changes, and what is the matter from there on.

    Args:
        cells: Of the array.
        faults: Of the scene.

    Attributes:
        next_turn: The tick in which a fault begins or ends next; ``NEVER``: none does.
    """

    def __init__(self, cells: int, faults: Sequence[Injected[PlantFault]] = ()) -> None:
        self._cells = cells
        self._faults = list(faults)
        self._turns: list[int] = []
        self.next_turn = NEVER
        self._plan(0)

    def add(self, fault: Injected[PlantFault], tick: int) -> None:
        """One more, from now on; ``tick`` is the next."""
        self._faults.append(fault)
        self._plan(tick)

    def turn(self, tick: int) -> Harm:
        """What is the matter from ``tick`` on, which is ``next_turn``."""
        self._plan(tick + 1)
        return self.harm(tick)

    def harm(self, tick: int) -> Harm:
        """What is the matter in a tick."""
        harm = Harm.none(self._cells)
        for injected in self._faults:
            if injected.acts(tick):
                injected.fault.harm(injected.cells, harm)
        return harm

    def _plan(self, tick: int) -> None:
        self._turns = [turn for turn in turns(self._faults) if turn >= tick]
        self.next_turn = self._turns[0] if self._turns else NEVER
