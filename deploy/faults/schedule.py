"""When the scheduled faults of a scene act."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from bus.lattice import Lattice
from deploy.faults import Fault

Deaths = dict[int, tuple[int, ...]]
"""Indices of the cells that are dead from a tick on, by that tick, ascending."""


class Timetable(Protocol):
    """What the schedule needs of ``deploy.scene.Scene``, which is made of faults itself."""

    @property
    def faults(self) -> Sequence[Fault]:
        """All of them, in the scene's order."""
        ...

    def lattice(self) -> Lattice:
        """The cells that exist."""
        ...

    def tick_at(self, at_s: float) -> int:
        """The tick in which something scheduled acts."""
        ...


def deaths(scene: Timetable) -> Deaths:
    """When which cells crash. A cell that is to crash twice dies the first time."""
    lattice = scene.lattice()
    first: dict[int, int] = {}
    for fault in scene.faults:
        cell, tick = lattice.index(fault.cell), scene.tick_at(fault.at_s)
        first[cell] = min(tick, first.get(cell, tick))
    by_tick: dict[int, list[int]] = {}
    for cell in sorted(first):
        by_tick.setdefault(first[cell], []).append(cell)
    return {tick: tuple(cells) for tick, cells in sorted(by_tick.items())}


def crash_aborts(cell: tuple[int, int], at_s: float) -> str:
    """Why a run is over, a cell of which crashed as the scene says, where the policy is ``abort``."""
    row, column = cell
    return f"cell {row},{column} crashed at {at_s:g} s as scheduled; stall.policy is abort"
