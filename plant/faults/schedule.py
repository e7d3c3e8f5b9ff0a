"""The faults of a run that act on the plant, begun and ended at ticks."""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar, final

from bus.fault import FaultInstance, transition_ticks
from bus.lattice import NO_TICK_LIMIT
from bus.state import StateFields
from plant.faults.base import PlantFault, WheelFaults


@final
class FaultSchedule:
    """Schedule of faults in the plant: transition ticks, and the fault state from each transition on.

    Args:
        cells: Number of cells in the array.
        faults: Faults of the scene.

    Attributes:
        transitions: Remaining ticks in which faults begin or end, ascending.
        next_transition: First of ``transitions``; ``NO_TICK_LIMIT`` if there is none.
    """

    state_fields: ClassVar[StateFields] = StateFields("transitions", "next_transition")

    def __init__(self, cells: int, faults: Sequence[FaultInstance[PlantFault]] = ()) -> None:
        self._cells = cells
        self._faults = list(faults)
        self.transitions: list[int] = []
        self.next_transition = NO_TICK_LIMIT
        self.plan(0)

    def add(self, fault: FaultInstance[PlantFault]) -> None:
        """Add a fault that begins no earlier than the next tick."""
        self._faults.append(fault)

    def plan(self, tick: int) -> None:
        """Recompute the transitions from ``tick`` on; ``tick`` is the next tick."""
        self.transitions = [turn for turn in transition_ticks(self._faults) if turn >= tick]
        self.next_transition = self.transitions[0] if self.transitions else NO_TICK_LIMIT

    def at_transition(self, tick: int) -> WheelFaults:
        """Return the fault state from the transition at ``tick`` on; ``tick`` equals ``next_transition``."""
        self.plan(tick + 1)
        return self.state_at(tick)

    def state_at(self, tick: int, *, live: bool = True) -> WheelFaults:
        """Return the fault state in a tick. ``live``: include faults injected at run time."""
        wheel_faults = WheelFaults.healthy(self._cells)
        for injected in self._faults:
            if injected.active_at(tick) and (live or not injected.injected_at_runtime):
                injected.fault.apply(injected.cells, wheel_faults)
        return wheel_faults
