"""A scene run once in this process, for what it comes to: no folder, no recording, no picture."""

from __future__ import annotations

import contextlib
import secrets
import sys
import time
from typing import TYPE_CHECKING

from bus.errors import BusError
from cell_firmware.effects.registry import CellEffects
from deploy.errors import DeployError
from deploy.runs.backends import BusCells
from deploy.runs.output import run_name
from deploy.runs.result import RunResult
from deploy.runs.setup import load_plant
from deploy.runs.simulation import Simulation
from deploy.scenes.fault_schedule import in_run_faults
from deploy.util.formatting import say
from deploy.workers.plan import RunOptions, plan
from deploy.workers.system import System
from plant.tick import TickHooks, TickRecord

if TYPE_CHECKING:
    from deploy.recordings.digest import Digest
    from deploy.runs.checking import Check
    from deploy.scenes.scene import Scene
    from plant.observations import Event


def needs_cells(scene: Scene) -> bool:
    """Whether a scene's cells do more than hold a field's speeds on ideal wheels."""
    return (
        scene.cells.firmware != "velocity_field"
        or scene.effects.motors is not None
        or bool(scene.faults)
        or any(name in CellEffects.model_fields for name, _ in scene.effects.enabled())
    )


def run_headless(scene: Scene, *, digest: Digest | None = None, check: Check | None = None) -> RunResult:
    """Run a scene with its cells to its end; the result has all its events and losses.

    The cells run in a thread of this process, over the memory transport.

    Args:
        scene: The scene.
        digest: Continued tick by tick.
        check: Whether the invariants of the program are checked, and what a violation does; None: they aren't.

    Raises:
        InputError: The plant refuses the scene.
    """
    # What a firmware prints in this process is no part of what the command prints.
    with contextlib.redirect_stdout(sys.stderr):
        return _run(scene, digest, check)


def _run(scene: Scene, digest: Digest | None, check: Check | None) -> RunResult:
    options = RunOptions(processes=0, transport="memory")
    events: list[Event] = []

    def after_tick(record: TickRecord) -> None:
        events.extend(record.events)
        if digest is not None:
            digest.tick(record.tick, record.sense.presence, record.drives, record.after)

    with System(plan(scene, options, run_name(scene, secrets.token_hex(4))), scene, options) as system:
        plant = load_plant(scene, say)
        checker = None
        if check is not None:
            from deploy.runs.checking import RunChecker

            faults = in_run_faults(scene)
            checker = RunChecker(scene, plant.array.lattice, check, lambda: faults)
        started = time.perf_counter()
        try:
            system.open()
            simulation = Simulation.open(
                scene,
                BusCells(system, () if checker is None else checker.wanted),
                hooks=TickHooks(after_tick=(after_tick,)),
                plant=plant,
            )
            coordinator = system.coordinator
            if checker is not None and coordinator is not None:
                simulation.add_hooks(TickHooks(after_tick=(checker.hook(coordinator.drain_registers),)))
        except (BusError, DeployError) as error:
            result = RunResult.of(plant)
            result.end("failed", str(error))
            result.wall_s = time.perf_counter() - started
        else:
            result = simulation.run()
            if checker is not None:
                checker.judge(result)
    result.events = tuple(events)
    return result
