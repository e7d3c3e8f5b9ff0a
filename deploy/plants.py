"""The plant of a scene, ready to run, and its process on the bus."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

from deploy.cell_times import cell_times
from deploy.errors import InputError
from deploy.faults.schedule import active, deaths, rests
from deploy.readings import camera_of
from plant.errors import PlantError, PlantStopped, PlantUnstable

if TYPE_CHECKING:
    from bus.fault import FaultSpec, Injected
    from bus.readings import Readings
    from deploy.scene import Scene
    from plant.plant import Plant
    from plant.process import LockstepHost, PlantProcess
    from plant.records import TickRecord


def load_plant(scene: Scene, warn: Callable[[str], None]) -> Plant:
    """The plant of a scene, its kernels compiled or loaded; says so where that takes long.

    Raises:
        InputError: The plant refuses the scene.
    """
    from plant.kernels.cache import folder
    from plant.plant import Plant
    from plant.solvers.registry import is_compiled

    motors = scene.effects.motors
    divided = scene.effects.clock is not None or (motors is not None and motors.first_order.static_v > 0.0)
    if not is_compiled(scene.solver, divided=divided):
        _, lasting = folder()
        once = "once" if lasting else "every time: the cache folder can't be written, see NUMBA_CACHE_DIR"
        warn(f"compiling the solver ({once}) ...")
    try:
        plant = Plant(scene.plant_spec())
    except PlantError as error:
        raise InputError(f"scene {scene.name}: {error}") from None
    if divided:
        plant.make_ready()
    return plant


def process_of(
    scene: Scene,
    plant: Plant,
    host: LockstepHost,
    readings: Readings,
    observe: Callable[[TickRecord], None],
    *,
    lasts: Sequence[Injected[FaultSpec]] | None = None,
    pace: Callable[[int], None] | None = None,
    attend: Callable[[int], None] | None = None,
) -> PlantProcess:
    """What runs a scene's plant in lockstep with its cells.

    Args:
        scene: What runs.
        plant: At its start.
        host: Of the lockstep.
        readings: What cells have to read.
        observe: Told of every tick.
        lasts: The scene's faults that begin and end, where there is more to do with them; see ``active``.
        pace: See ``PlantProcess``.
        attend: Likewise.
    """
    from plant.process import PlantProcess

    return PlantProcess(
        plant,
        host,
        tick_ns=scene.tick_ns,
        duration_ns=scene.duration_ns,
        schedule=deaths(scene),
        stall=scene.stall,
        stops=scene.cells.on_failure == "stop",
        timing=cell_times(scene),
        camera=camera_of(scene, readings),
        faults=active(scene, lasts),
        rests=rests(scene),
        observer=observe,
        pace=pace,
        attend=attend,
    )


def status_of(error: PlantError) -> str:
    """``unstable`` where a motion can't be followed, ``interrupted`` where it was to end, else ``failed``."""
    if isinstance(error, PlantStopped):
        return "interrupted"
    return "unstable" if isinstance(error, PlantUnstable) else "failed"
