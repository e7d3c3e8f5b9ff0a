"""Check of a protocol: a search for faults that break a condition, and a replay of the counterexample in a lab."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from cell_firmware.firmware import Cells
from cell_firmware.invariants import declares_invariants
from cell_firmware.loader import find, load
from deploy.errors import DeployError, InputError
from deploy.lab.faults import Table, in_seconds, write_scene
from deploy.lab.lab import Lab
from deploy.runs.checking import InvariantBroken
from deploy.scenes.files import load_scene
from deploy.studies.adversary.sample import SampleResult, sample
from deploy.studies.adversary.search import SearchResult, search
from deploy.studies.adversary.spec import Adversary, Schedule, tables_of
from deploy.studies.adversary.world import Environment, World
from plant.array import CellArray

if TYPE_CHECKING:
    from cell_firmware.array_view import Violation
    from deploy.scenes.scene import Scene

_LONG_S: Final = 1e9


@final
@dataclass(frozen=True, slots=True)
class Counterexample:
    """Faults that break a condition of a program.

    Attributes:
        scene: The scene, without the faults.
        faults: Tables of the faults.
        violation: The condition that is broken, as a lab finds it.
        ticks: Ticks up to the violation.
    """

    scene: Scene
    faults: tuple[Table, ...]
    violation: Violation
    ticks: int

    def write(self, path: Path) -> None:
        """Write a scene file that ``mdms run --check`` stops in the same tick.

        Raises:
            FirmwareError: The firmware is an object that another process can't import.
            DeployError: The file can't be written.
        """
        write_scene(path, self.scene, self.faults, self.ticks, f"Counterexample: {self.violation.rule}")


def world_scene(
    firmware: object,
    lattice: tuple[int, int] | Sequence[tuple[int, int]],
    *,
    parameters: Mapping[str, Any] | None = None,
    initial_registers: Mapping[str, Any] | None = None,
    seed: int = 0,
) -> Scene:
    """Return the scene of a small world.

    Args:
        firmware: As for ``Lab``.
        lattice: ``(rows, columns)``, or the ``(row, column)`` of every cell.
        parameters: The firmware's own.
        initial_registers: Variables that begin with other values.
        seed: Seed of all random streams.

    Raises:
        SceneError: A value is refused.
        InputError: The program has no conditions, or draws random numbers.
    """
    lab = Lab(
        firmware, lattice, parameters=parameters, initial_registers=initial_registers, seed=seed, check=None
    )
    program = load(lab.scene.cells)
    if program.random:
        raise InputError(
            f"the program {lab.scene.cells.firmware} draws random numbers ({', '.join(program.random)}): a search "
            "merges equal states, which go on alike only without chance"
        )
    if not declares_invariants(program):
        raise InputError(
            f"the program {lab.scene.cells.firmware} has no conditions to check: it defines neither invariants(view) "
            "nor eventually(view)"
        )
    return lab.scene


def counters_near_wraps(firmware: str) -> dict[str, int]:
    """Return the program's counters with values two short of their wraps; none for programs that declare none.

    Args:
        firmware: As in a scene.

    Raises:
        FirmwareError: There is no such program.
    """
    return {name: wrap - 2 for name, wrap in find(firmware).counters.items()}


def world_of(
    scene: Scene,
    adversary: Adversary,
    covered: Sequence[tuple[int, int]] = (),
    environment: Environment | None = None,
) -> World:
    """Return the world of a scene's cells.

    Args:
        scene: The scene; its faults, effects and parcels are not used.
        adversary: What may happen.
        covered: Cells that are covered in all ticks.
        environment: What covers cells from tick to tick instead; None without one.
    """
    array = CellArray(scene.array)
    lattice = array.lattice
    cells = Cells.of(
        lattice, array.positions_m, scene.cells.period_s, scene.array.sensors_m, pitch_m=array.pitch_m
    )
    indices = [lattice.index(cell) for cell in covered]
    return World(load(scene.cells), scene.cells.firmware, cells, lattice, adversary, indices, environment)


def check_exhaustively(
    scene: Scene,
    adversary: Adversary,
    covered: Sequence[tuple[int, int]] = (),
    *,
    symmetric: bool = True,
    most_states: int = 2_000_000,
    limit_s: float = 120.0,
    poll: Callable[[], None] = lambda: None,
) -> tuple[SearchResult, Counterexample | None]:
    """Search all states of a small world; what is found has been replayed in a lab.

    Args:
        scene: Scene of ``world_scene``.
        adversary: What may happen.
        covered: Cells that are covered in all ticks.
        symmetric: Whether symmetric states are merged.
        most_states: Most states.
        limit_s: Most wall time, s.
        poll: Called many times; may raise.
    """
    world = world_of(scene, adversary, covered)
    indices = [world.lattice.index(cell) for cell in covered]
    result = search(world, indices, symmetric=symmetric, most_states=most_states, limit_s=limit_s, poll=poll)
    if result.schedule is None or result.violation is None:
        return result, None
    return result, replayed(scene, result.schedule, result.violation.tick, covered)


def check_by_sampling(
    scene: Scene,
    adversary: Adversary,
    schedules: int,
    covered: Sequence[tuple[int, int]] = (),
    *,
    limit_s: float = 120.0,
) -> tuple[SampleResult, Counterexample | None]:
    """Follow random schedules; a counterexample has been shrunk, and replayed in a lab.

    Args:
        scene: Scene of ``world_scene``; its seed is that of the draws.
        adversary: What may happen.
        schedules: Number of schedules to draw.
        covered: Cells that are covered in all ticks.
        limit_s: Most wall time, s.

    Raises:
        InputError: Hypothesis is not installed.
    """
    world = world_of(scene, adversary, covered)
    result = sample(world, schedules, seed=scene.seed, limit_s=limit_s)
    if result.schedule is None or result.violation is None:
        return result, None
    return result, replayed(scene, result.schedule, result.violation.tick, covered)


def replayed(
    scene: Scene, schedule: Schedule, tick: int, covered: Sequence[tuple[int, int]] = ()
) -> Counterexample:
    """Replay a schedule as the faults of a scene, in a lab, and return what breaks there.

    Args:
        scene: The scene.
        schedule: Faults by tick.
        tick: Tick in which a condition was found broken.
        covered: Cells that are covered in all ticks.

    Raises:
        DeployError: The lab finds something else: a bug of the search.
    """
    lattice = scene.lattice()
    faults = [in_seconds(one, scene.tick_ns) for one in tables_of(schedule, lattice)]
    if covered:
        cells = [list(cell) for cell in covered]
        faults.append({"kind": "sensor_stuck", "cells": cells, "value": 1})
    tables = scene.model_dump(mode="json", exclude_unset=True, exclude_none=True)
    whole = load_scene({**tables, "duration_s": _LONG_S, "faults": faults})
    lab = Lab.of(whole)
    try:
        lab.step(tick + 1)
    except InvariantBroken as error:
        if error.violations[0].tick == tick:
            return Counterexample(scene, tuple(faults), error.violations[0], tick + 1)
        found = f"breaks in tick {error.violations[0].tick}"
    except Exception as error:  # noqa: BLE001 - a program that fails is what was found
        return _failure(scene, faults, tick, lab, error)
    else:
        found = "breaks nothing"
    raise DeployError(
        f"this is a bug: a schedule that breaks a condition in tick {tick} {found} in a lab: {faults}"
    )


def _failure(scene: Scene, faults: Sequence[Table], tick: int, lab: Lab, error: Exception) -> Counterexample:
    from cell_firmware.array_view import Violation

    if lab.tick not in (tick, tick + 1):
        raise error
    line = str(error).partition("\n")[0]
    return Counterexample(scene, tuple(faults), Violation("always", line, tick), tick + 1)
