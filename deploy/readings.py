"""What the cells of a scene can read: settled before they start."""

from __future__ import annotations

from typing import TYPE_CHECKING

from bus.readings import Readings

if TYPE_CHECKING:
    from deploy.scene import Scene
    from plant.camera import Camera
    from plant.reports import Sense


def readings_of(scene: Scene, sense: Sense) -> Readings:
    """What there is to read, from the scene and from what its cells sense first.

    A camera is there for programs that subscribe to it: nobody is shown its pictures otherwise.
    """
    from cell_firmware.loader import load

    effects = scene.effects
    exits = () if effects.feeders is None else effects.feeders.exits
    subscribed = effects.camera is not None and load(scene.cells).subscribes()
    return Readings(
        len(scene.array.sensors_m),
        encoders=sense.encoder_m is not None,
        levels=sense.level is not None,
        labels=0 if sense.label is None else max(1, len(exits)),
        camera=scene.parcel_count if subscribed else 0,
    )


def camera_of(scene: Scene, readings: Readings) -> Camera | None:
    """What takes the pictures that these cells are shown; None where nothing does."""
    if not readings.camera:
        return None
    from plant.parts import make_camera

    # where cells have clocks of their own, what a tick brings them they read in the tick before
    later = 0 if scene.effects.clock is None else 1
    return make_camera(scene.effects.of_plant(), scene.tick_ns, scene.seed, later)
