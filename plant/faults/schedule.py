"""The faults of a run that act on the plant, begun and ended at ticks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, final

from bus.fault import Injected, turns
from bus.lattice import NEVER
from bus.state import Remembers
from plant.faults.base import Harm, PlantFault


@final
class ActiveFaults:
    """Says in which ticks something changes, and what is the matter from there on.

    Args:
        cells: Of the array.
        faults: Of the scene.

    Attributes:
        turns: The ticks in which faults begin or end from now on, ascending.
        next_turn: The first of them; ``NEVER``: none does.
    """

    remembers: ClassVar[Remembers] = Remembers("turns", "next_turn")

    def __init__(self, cells: int, faults: Sequence[Injected[PlantFault]] = ()) -> None:
        self._cells = cells
        self._faults = list(faults)
        self.turns: list[int] = []
        self.next_turn = NEVER
        self.plan(0)

    def add(self, fault: Injected[PlantFault]) -> None:
        """One more, which begins no earlier than the next tick."""
        self._faults.append(fault)

    def plan(self, tick: int) -> None:
        """Look again at when they begin and end; ``tick`` is the next."""
        self.turns = [turn for turn in turns(self._faults) if turn >= tick]
        self.next_turn = self.turns[0] if self.turns else NEVER

    def turn(self, tick: int) -> Harm:
        """What is the matter from ``tick`` on, which is ``next_turn``."""
        self.plan(tick + 1)
        return self.harm(tick)

    def harm(self, tick: int, *, live: bool = True) -> Harm:
        """What is the matter in a tick, because of the scene's faults alone if ``live`` is false."""
        harm = Harm.none(self._cells)
        for injected in self._faults:
            if injected.acts(tick) and (live or not injected.live):
                injected.fault.harm(injected.cells, harm)
        return harm
