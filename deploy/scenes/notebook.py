"""A scene in a notebook: facts, and the array with the parcels where they start."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from deploy.util.formatting import plural
from deploy.util.notebook import array_svg, facts_html
from plant.array import CellArray
from plant.geometry import centroid, counter_clockwise, placed

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene


def scene_html(scene: Scene) -> str:
    """Return the representation of a scene."""
    array = CellArray(scene.array)
    effects = [name for name, _ in scene.effects.enabled()]
    facts = [
        ("scene", scene.name),
        ("array", f"{plural(len(array), 'cell')}, pitch {array.pitch_m:g} m"),
        ("firmware", f"{scene.cells.firmware}, every {scene.cells.period_s:g} s"),
        ("parcels", str(scene.parcel_count)),
        ("friction", scene.friction.model_dump()["law"]),
        ("solver", scene.solver.name),
        ("effects", ", ".join(effects) or "none"),
        ("faults", str(len(scene.faults))),
        ("duration", f"{scene.duration_s:g} s, {plural(scene.ticks, 'tick')}"),
        ("seed", str(scene.seed)),
    ]
    outlines: list[NDArray[np.float64]] = []
    for parcel in scene.parcels:
        corners = counter_clockwise(parcel.polygon())
        centre = parcel.centre_of_mass_m or centroid(parcel.polygon())
        outlines.append(placed(corners - np.array(centre), np.array([*parcel.position_m, parcel.angle_rad])))
    return facts_html(scene.title or scene.name, facts, array_svg(array.positions_m, array.pitch_m, outlines))
