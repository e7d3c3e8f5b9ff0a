"""What the orientations of a scene's parcel are found from: the field's wheel speeds, the parcel, a place for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from deploy.errors import InputError
from deploy.simulate import field_speeds
from plant.array import CellArray
from plant.continuum import continuous_torque, linear_field, loaded_moments
from plant.equilibrium import resting_place
from plant.errors import PlantError
from plant.turntable import Turntable

if TYPE_CHECKING:
    from deploy.scene import Scene
    from plant.orientations import TorqueProfile
    from plant.wheels import Floats


@final
@dataclass(frozen=True, slots=True)
class Study:
    """A parcel of a scene, and the point its centre of mass stays at.

    Attributes:
        scene: The scene.
        parcel: Which of its parcels.
        array: Its cells.
        speeds_m_s: ``(n, 2)`` of their wheels.
        table: The field to turn parcels on.
        centre_m: ``(2,)`` the point.
    """

    scene: Scene
    parcel: int
    array: CellArray
    speeds_m_s: Floats
    table: Turntable
    centre_m: Floats

    def profile(self) -> TorqueProfile:
        """Torque against angle.

        Raises:
            InputError: The parcel stands at that point at no angle.
        """
        try:
            return self.table.turn(self.scene.parcels[self.parcel], self.centre_m)
        except PlantError as error:
            raise InputError(f"scene {self.scene.name}: {error}") from None

    def continuous(self, angles_rad: Floats) -> Floats | None:
        """Torque ``(k,)``, N m, on a continuous surface; None where the field isn't linear, or loads would pull."""
        field = linear_field(self.array.positions_m, self.speeds_m_s)
        parcel = self.scene.parcels[self.parcel]
        moments = loaded_moments(parcel)
        if field is None or moments is None:
            return None
        return self.table.drag_n_s_per_m(parcel) * continuous_torque(angles_rad, field, moments)


def study(scene: Scene, parcel: int, centre_m: Sequence[float] | None) -> Study:
    """Prepare the study of a parcel.

    Args:
        scene: Its firmware must be ``velocity_field``.
        parcel: Which parcel; must exist.
        centre_m: Where its centre of mass is; None: where the field brings it to rest.

    Raises:
        InputError: The firmware or the law is another, or the field brings the parcel to rest at no point.
    """
    array = CellArray(scene.array)
    speeds = field_speeds(scene, array.positions_m)
    spec = scene.plant_spec()
    try:
        table = Turntable(spec, speeds)
    except PlantError as error:
        raise InputError(f"scene {scene.name}: {error}") from None
    try:
        place = resting_place(spec, parcel, speeds) if centre_m is None else np.array(centre_m)
    except PlantError as error:
        raise InputError(f"scene {scene.name}: {error}: give a point with --at X,Y") from None
    return Study(scene, parcel, array, speeds, table, place)
