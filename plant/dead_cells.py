"""Cells without a driving program (dead or removed), and the drives of their wheels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, ClassVar, Protocol, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant.wheels import Floats, LossPolicy

if TYPE_CHECKING:
    from plant.faults.base import WheelFaults


class WheelControl(Protocol):
    """Operations of ``plant.plant.Plant`` on the wheels of dead cells."""

    def release_wheels(self, cells: Sequence[int], policy: LossPolicy) -> None:
        """Let the wheels of newly dead cells follow ``policy``."""
        ...

    def engage_wheels(self, cells: Sequence[int]) -> None:
        """Let the wheels of revived cells follow drives again."""
        ...

    def apply_faults(self, wheel_faults: WheelFaults, drives: Floats) -> None:
        """Apply a fault state to wheels and cells; ``drives`` act from then on."""
        ...


@final
class DeadCells:
    """Dead and removed cells of a run, and the drives of their wheels.

    Args:
        plant: Plant whose wheels are released and engaged.
        cells: Number of cells in the array.
        policy: Policy for the wheels of dead cells.
        rests: Policy of a cell that dies for good, by cell, where it differs from ``policy``.

    Attributes:
        mask: Whether no program drives the cell, ``(n,)``; None before the first death or fault transition.
        lost: Whether the cell is dead for good, ``(n,)``; only ``revive`` clears it.
    """

    state_fields: ClassVar[StateFields] = StateFields("_down", "_gone", "_given", "mask", "lost")

    def __init__(
        self,
        plant: WheelControl,
        cells: int,
        policy: LossPolicy,
        rests: Mapping[int, LossPolicy] | None = None,
    ) -> None:
        self._plant = plant
        self._policy: LossPolicy = policy
        self._rests = rests or {}
        self._down: dict[int, LossPolicy] = {}
        """Cells that are dead until a fault is repaired, with the policy of their wheels."""
        self._gone: NDArray[np.bool_] = np.zeros(cells, dtype=np.bool_)
        self._given: Floats = np.zeros((cells, 2))
        self.mask: NDArray[np.bool_] | None = None
        self.lost: NDArray[np.bool_] = np.zeros(cells, dtype=np.bool_)

    def override_drives(self, drives: Floats) -> Floats:
        """Return the drives, ``(n, 2)``, with those of dead and removed cells replaced."""
        return drives if self.mask is None else np.where(self.mask[:, None], self._given, drives)

    def mark_dead(self, cells: Sequence[int], drives: Floats) -> tuple[int, ...]:
        """Mark cells as dead for good, and return the newly dead ones.

        Args:
            cells: Indices of the cells.
            drives: Last drives, ``(n, 2)``; policy ``hold`` keeps them.
        """
        fresh = tuple(cell for cell in cells if not self.lost[cell])
        if fresh:
            self.lost[list(fresh)] = True
            self._leave({cell: self._rests.get(cell, self._policy) for cell in fresh}, drives)
            self._mark()
        return fresh

    def revive(self, cells: Sequence[int]) -> None:
        """Clear the death of rejoining cells; a cell that an active fault kills stays dead."""
        self.lost[list(cells)] = False
        back = [cell for cell in cells if cell not in self._down]
        self._plant.engage_wheels(back)
        self._given[back] = 0.0
        self._mark()

    def about_to_die(self, wheel_faults: WheelFaults) -> list[int]:
        """Return the live cells that the fault state ``wheel_faults`` kills, ascending."""
        return [
            cell for cell in np.flatnonzero(wheel_faults.dead & ~self.lost).tolist() if cell not in self._down
        ]

    def on_transition(self, wheel_faults: WheelFaults, drives: Floats) -> bool:
        """Apply a new fault state, and return whether modules were removed or plugged in.

        Args:
            wheel_faults: Combined effect of the active faults.
            drives: Last drives, ``(n, 2)``.
        """
        dead: list[int] = np.flatnonzero(wheel_faults.dead).tolist()
        before = self._down
        self._down = {cell: wheel_faults.wheel_policies.get(cell, self._policy) for cell in dead}
        changed = [cell for cell in before if self._down.get(cell) != before[cell] and not self.lost[cell]]
        fresh = [cell for cell in dead if self._down[cell] != before.get(cell) and not self.lost[cell]]
        if changed:
            self._plant.engage_wheels(changed)
            self._given[changed] = 0.0
        self._leave({cell: self._down[cell] for cell in fresh}, drives)
        moved = bool((wheel_faults.gone != self._gone).any())
        self._gone = wheel_faults.gone
        self._given[wheel_faults.gone] = 0.0
        self._mark()
        self._plant.apply_faults(wheel_faults, self.override_drives(drives))
        return moved

    def _leave(self, leaving: Mapping[int, LossPolicy], drives: Floats) -> None:
        """Release the wheels of dying cells, each with its policy; ``hold`` keeps the last drives."""
        for policy in sorted(set(leaving.values())):
            cells = tuple(cell for cell, does in leaving.items() if does == policy)
            if policy == "hold":
                self._given[list(cells)] = drives[list(cells)]
            self._plant.release_wheels(cells, policy)

    def _mark(self) -> None:
        self.mask = self.lost | self._gone
        self.mask[list(self._down)] = True
