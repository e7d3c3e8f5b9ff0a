"""When the scheduled faults of a scene act."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from deploy.scene import Scene

Deaths = dict[int, tuple[int, ...]]
"""Indices of the cells that are dead from a tick on, by that tick, ascending."""


def deaths(scene: Scene) -> Deaths:
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
