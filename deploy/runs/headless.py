"""A scene run once in this process, for what it comes to: no folder, no recording, no picture."""

from __future__ import annotations

import contextlib
import secrets
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

from bus.errors import BusError
from cell_firmware.effects.registry import CellEffects
from deploy.errors import DeployError
from deploy.recordings.losses import failure, nobody
from deploy.runs.field_simulation import field_speeds
from deploy.runs.output import run_name
from deploy.runs.setup import load_plant, process_of, sensor_schema, status_of
from deploy.util.formatting import say
from deploy.workers.plan import RunOptions, plan
from deploy.workers.system import System
from plant.errors import PlantError

if TYPE_CHECKING:
    from bus.lockstep.counters import Loss
    from deploy.recordings.digest import Digest
    from deploy.scenes.scene import Scene
    from plant.observations import Event, ParcelStatus
    from plant.plant import Plant
    from plant.process import LoopResult, PlantProcess, TickRecord
    from plant.wheels import Floats


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class HeadlessResult:
    """What a run came to.

    Attributes:
        status: ``ok``, ``failed``, ``stalled`` or ``unstable``.
        reason: Why it isn't ``ok``; empty where it is.
        states: ``(m, 6)`` of all parcels at the end.
        fates: How each parcel fares at the end.
        footprints_m: ``(v, 2)`` corners of each about its centre of mass, in its axes.
        events: Of the plant, all of them.
        misrouted: Parcels that left by another exit than theirs.
        cells_lost: Cells that were lost though the scene did not say so: their program raised, or they stalled.
        wall_s: Of the run itself, without start-up.
    """

    status: str
    reason: str
    states: Floats
    parcel_status: Sequence[ParcelStatus]
    footprints_m: Sequence[Floats]
    events: Sequence[Event]
    wall_s: float
    misrouted: int = 0
    cells_lost: int = 0


def needs_cells(scene: Scene) -> bool:
    """Whether a scene's cells do more than hold a field's speeds on ideal wheels."""
    return (
        scene.cells.firmware != "velocity_field"
        or scene.effects.motors is not None
        or bool(scene.faults)
        or any(name in CellEffects.model_fields for name, _ in scene.effects.enabled())
    )


def run_headless(scene: Scene, *, cells: bool, digest: Digest | None = None) -> HeadlessResult:
    """Run a scene to its end, tick by tick.

    Without cells the bits of the motion are those that it has with them, where `needs_cells` says that they do nothing
    else; only the messages are spared.

    Args:
        scene: What to run.
        cells: Whether its cells run too, in a thread of this process, over the memory transport.
        digest: Continued tick by tick, of a run with cells.

    Raises:
        InputError: The plant refuses the scene.
    """
    # What a firmware prints in this process is no part of what the command prints.
    with contextlib.redirect_stdout(sys.stderr):
        return _with_cells(scene, digest) if cells else _plant_alone(scene)


def _plant_alone(scene: Scene) -> HeadlessResult:
    from plant.array import CellArray

    speeds = field_speeds(scene, CellArray(scene.array).positions_m)
    plant = load_plant(scene, say)
    events: list[Event] = []
    period_ns, end_ns = scene.tick_ns, scene.duration_ns
    status, reason = "ok", ""
    started = time.perf_counter()
    try:
        for tick in range(scene.ticks):
            _, happened = plant.advance(speeds, min((tick + 1) * period_ns, end_ns))
            events += happened
    except PlantError as error:
        status, reason = status_of(error), str(error)
    return _course(plant, events, time.perf_counter() - started, status, reason)


def _with_cells(scene: Scene, digest: Digest | None) -> HeadlessResult:
    options = RunOptions(processes=0, transport="memory")
    events: list[Event] = []
    lost: list[Loss] = []

    def observe(record: TickRecord) -> None:
        events.extend(record.events)
        lost.extend(record.losses)
        if digest is not None:
            digest.tick(record.tick, record.sense.presence, record.drives, record.after)

    status, reason = "ok", ""
    started = time.perf_counter()
    with System(plan(scene, options, run_name(scene, secrets.token_hex(4))), scene, options) as system:
        plant = load_plant(scene, say)
        try:
            system.open()
            process = _process(scene, system, plant, observe)
            started = time.perf_counter()
            ended = process.run()
            lost.extend(ended.losses)
            status, reason = ended.status, _why(ended, lost, plant, scene.tick_ns)
        except (BusError, DeployError) as error:
            status, reason = "failed", str(error)
        except PlantError as error:
            status, reason = status_of(error), str(error)
        wall_s = time.perf_counter() - started
    return _course(plant, events, wall_s, status, reason, len(lost))


def _process(
    scene: Scene, system: System, plant: Plant, observe: Callable[[TickRecord], None]
) -> PlantProcess:
    readings = sensor_schema(scene, plant.sense())
    return process_of(scene, plant, system.start(plant.array, readings), readings, observe)


def _why(ended: LoopResult, lost: Sequence[Loss], plant: Plant, period_ns: int) -> str:
    cells = plant.array.lattice.cells
    if ended.failed:
        return failure(ended.failed, cells, period_ns)
    if ended.nobody:
        return nobody(lost, cells, period_ns)
    return "" if ended.status == "ok" else "a cell was lost, and stall.policy is abort"


def _course(
    plant: Plant, events: Sequence[Event], wall_s: float, status: str, reason: str, cells_lost: int = 0
) -> HeadlessResult:
    traffic = plant.traffic()
    return HeadlessResult(
        status=status,
        reason=reason,
        states=plant.state,
        parcel_status=tuple(plant.status),
        footprints_m=plant.footprints_m,
        events=tuple(events),
        misrouted=0 if traffic is None else traffic.misrouted,
        cells_lost=cells_lost,
        wall_s=wall_s,
    )
