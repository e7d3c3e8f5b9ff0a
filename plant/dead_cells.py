"""Whose wheels no program drives: cells that are dead, or not there; and what they are given instead."""

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
    """What is needed of ``plant.plant.Plant``."""

    def release_wheels(self, cells: Sequence[int], policy: LossPolicy) -> None:
        """Note that cells are dead from now on."""
        ...

    def engage_wheels(self, cells: Sequence[int]) -> None:
        """Note that cells that were dead are so no longer."""
        ...

    def apply_faults(self, harm: WheelFaults, drives: Floats) -> None:
        """Let faults do to wheels and cells what they say."""
        ...


@final
class DeadCells:
    """The cells that go, and come back.

    Args:
        plant: Told of them.
        cells: Of the array.
        policy: What the wheels of dead cells do.
        rests: What those of cells do that die for good, by cell, where it is something else.

    Attributes:
        mask: ``(n,)``: those that no program drives; None: nobody ever was.
        lost: ``(n,)``: those dead for good.
    """

    remembers: ClassVar[StateFields] = StateFields("_down", "_gone", "_given", "mask", "lost")

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
        """Those that may be repaired, and what their wheels do."""
        self._gone: NDArray[np.bool_] = np.zeros(cells, dtype=np.bool_)
        self._given: Floats = np.zeros((cells, 2))
        self.mask: NDArray[np.bool_] | None = None
        self.lost: NDArray[np.bool_] = np.zeros(cells, dtype=np.bool_)

    def override_drives(self, drives: Floats) -> Floats:
        """The drives ``(n, 2)``, but what wheels are given that no program drives."""
        return drives if self.mask is None else np.where(self.mask[:, None], self._given, drives)

    def mark_dead(self, cells: Sequence[int], drives: Floats) -> tuple[int, ...]:
        """Note that these are dead for good, ``drives`` being the last; returns those that were not before."""
        fresh = tuple(cell for cell in cells if not self.lost[cell])
        if fresh:
            self.lost[list(fresh)] = True
            self._leave({cell: self._rests.get(cell, self._policy) for cell in fresh}, drives)
            self._mark()
        return fresh

    def revive(self, cells: Sequence[int]) -> None:
        """These are dead no longer; what faults say of them still holds."""
        self.lost[list(cells)] = False
        back = [cell for cell in cells if cell not in self._down]
        self._plant.engage_wheels(back)
        self._given[back] = 0.0
        self._mark()

    def about_to_die(self, harm: WheelFaults) -> list[int]:
        """Those that ``harm`` kills, ascending, which live now."""
        return [cell for cell in np.flatnonzero(harm.dead & ~self.lost).tolist() if cell not in self._down]

    def on_transition(self, harm: WheelFaults, drives: Floats) -> bool:
        """Something else is the matter from now on, ``drives`` being the last; returns whether cells came or went."""
        dead: list[int] = np.flatnonzero(harm.dead).tolist()
        before = self._down
        self._down = {cell: harm.wheel_policies.get(cell, self._policy) for cell in dead}
        changed = [cell for cell in before if self._down.get(cell) != before[cell] and not self.lost[cell]]
        fresh = [cell for cell in dead if self._down[cell] != before.get(cell) and not self.lost[cell]]
        if changed:
            self._plant.engage_wheels(changed)
            self._given[changed] = 0.0
        self._leave({cell: self._down[cell] for cell in fresh}, drives)
        moved = bool((harm.gone != self._gone).any())
        self._gone = harm.gone
        self._given[harm.gone] = 0.0
        self._mark()
        self._plant.apply_faults(harm, self.override_drives(drives))
        return moved

    def _leave(self, leaving: Mapping[int, LossPolicy], drives: Floats) -> None:
        """From now on the wheels of these cells do what dead ones do, each what is said of it."""
        for policy in sorted(set(leaving.values())):
            cells = tuple(cell for cell, does in leaving.items() if does == policy)
            if policy == "hold":
                self._given[list(cells)] = drives[list(cells)]
            self._plant.release_wheels(cells, policy)

    def _mark(self) -> None:
        self.mask = self.lost | self._gone
        self.mask[list(self._down)] = True
