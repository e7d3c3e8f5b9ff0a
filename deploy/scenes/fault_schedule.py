"""Schedule of a scene's faults: ticks and affected cells."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultInstance, FaultSpec
from bus.lattice import NO_TICK_LIMIT, Lattice
from cell_firmware.faults.base import CellFault
from deploy.faults.crash import CrashFault
from plant.faults.base import PlantFault

if TYPE_CHECKING:
    from plant.effects.motors import MotorsSpec
    from plant.faults.schedule import FaultSchedule
    from plant.wheels import LossPolicy

Deaths = dict[int, tuple[int, ...]]
"""Indices of the cells that are dead for good from a tick on, by that tick, ascending."""


class Timetable(Protocol):
    """Part of ``deploy.scenes.scene.Scene`` that the schedule needs; avoids a circular import."""

    @property
    def faults(self) -> Sequence[FaultSpec]:
        """All faults, in the scene's order."""
        ...

    @property
    def seed(self) -> int:
        """Seed of all random streams."""
        ...

    def lattice(self) -> Lattice:
        """The cells that exist."""
        ...

    def tick_at(self, at_s: float) -> int:
        """The tick in which something scheduled acts."""
        ...


def instances(scene: Timetable) -> tuple[FaultInstance[FaultSpec], ...]:
    """Bind the scene's faults to affected cells and ticks, in the scene's order."""
    if not scene.faults:
        return ()
    lattice = scene.lattice()
    return tuple(
        FaultInstance(
            number,
            fault,
            fault.affected_cells(lattice, scene.seed, number),
            *fault.tick_range(scene.tick_at),
        )
        for number, fault in enumerate(scene.faults)
    )


def permanent_crashes(scene: Timetable) -> Deaths:
    """List permanent crashes by tick. A cell with two crashes dies at the first."""
    first: dict[int, int] = {}
    for one in instances(scene):
        if is_permanent_crash(one):
            for cell in one.cells.tolist():
                first[cell] = min(one.start_tick, first.get(cell, one.start_tick))
    by_tick: dict[int, list[int]] = {}
    for cell in sorted(first):
        by_tick.setdefault(first[cell], []).append(cell)
    return {tick: tuple(cells) for tick, cells in sorted(by_tick.items())}


def crash_wheel_policies(scene: Timetable) -> dict[int, LossPolicy]:
    """Return the wheel policies of permanent crashes, by cell, where the fault sets a policy."""
    found: dict[int, tuple[int, LossPolicy | None]] = {}
    for one in instances(scene):
        if isinstance(one.fault, CrashFault) and is_permanent_crash(one):
            for cell in one.cells.tolist():
                if cell not in found or one.start_tick < found[cell][0]:
                    found[cell] = one.start_tick, one.fault.wheels
    return {cell: wheels for cell, (_, wheels) in found.items() if wheels is not None}


def in_run_faults(scene: Timetable) -> tuple[FaultInstance[FaultSpec], ...]:
    """Select all faults except permanent crashes: faults of cells that stay in the lockstep."""
    return tuple(one for one in instances(scene) if not is_permanent_crash(one))


def of_cells(faults: Sequence[FaultInstance[FaultSpec]]) -> tuple[FaultInstance[CellFault], ...]:
    """Select the in-run faults that the cells implement."""
    return tuple(cast("FaultInstance[CellFault]", one) for one in faults if isinstance(one.fault, CellFault))


def of_plant(faults: Sequence[FaultInstance[FaultSpec]]) -> tuple[FaultInstance[PlantFault], ...]:
    """Select the in-run faults that the plant implements."""
    return tuple(
        cast("FaultInstance[PlantFault]", one) for one in faults if isinstance(one.fault, PlantFault)
    )


def disturbs(faults: Sequence[FaultInstance[FaultSpec]], tick: int) -> bool:
    """Whether a fault begins or ends in a tick, or acts on running programs and will end."""
    return any(
        tick in (one.start_tick, one.end_tick)
        or (one.start_tick < tick < one.end_tick != NO_TICK_LIMIT and not _halts(one))
        for one in faults
    )


def _halts(one: FaultInstance[FaultSpec]) -> bool:
    """Whether a fault halts programs."""
    return isinstance(one.fault, CellFault) and one.fault.halts_program


def halted_cells(faults: Sequence[FaultInstance[FaultSpec]], tick: int, cells: int) -> NDArray[np.bool_]:
    """Return which cells' programs a fault halts in a tick, ``(cells,)``: crashes, removed modules, hangs, reboots."""
    halted = np.zeros(cells, dtype=np.bool_)
    for one in faults:
        if _halts(one) and one.active_at(tick):
            halted[one.cells] = True
    return halted


def cell_only_faults(scene: Timetable) -> list[str]:
    """List the faults that a plant without cells leaves out, as ``faults[2] (hang)``."""
    return [
        f"faults[{number}] ({fault.kind_name})"
        for number, fault in enumerate(scene.faults)
        if not isinstance(fault, PlantFault)
    ]


def on_ideal_wheels(scene: Timetable, motors: MotorsSpec) -> tuple[FaultSpec, ...]:
    """The scene's faults, where its motors are left out."""
    return tuple(
        fault.on_ideal_wheels(motors) if isinstance(fault, PlantFault) else fault for fault in scene.faults
    )


def active(scene: Timetable, lasts: Sequence[FaultInstance[FaultSpec]] | None = None) -> FaultSchedule | None:
    """Build the schedule of faults in the plant; None where the plant has no faults.

    Args:
        scene: Scene of the run.
        lasts: Result of ``in_run_faults(scene)``, if already computed.
    """
    faults = of_plant(in_run_faults(scene) if lasts is None else lasts)
    if not faults:
        return None
    from plant.faults.schedule import FaultSchedule

    return FaultSchedule(len(scene.lattice()), faults)


def is_permanent_crash(one: FaultInstance[FaultSpec]) -> bool:
    """Whether its cells leave the lockstep, never to come back: a scheduled crash that is not repaired."""
    return isinstance(one.fault, CrashFault) and one.end_tick == NO_TICK_LIMIT and not one.injected_at_runtime


def crash_aborts(cell: tuple[int, int], at_s: float) -> str:
    """Describe why a scheduled crash ends a run under the policy ``abort``."""
    row, column = cell
    return f"cell {row},{column} crashed at {at_s:g} s as scheduled; stall.policy is abort"
