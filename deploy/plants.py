"""The plant of a scene, ready to run."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from deploy.errors import InputError
from plant.errors import PlantError, PlantUnstable

if TYPE_CHECKING:
    from deploy.scene import Scene
    from plant.plant import Plant


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


def status_of(error: PlantError) -> str:
    """``unstable`` where the numbers ran away, else ``failed``."""
    return "unstable" if isinstance(error, PlantUnstable) else "failed"
