"""Where a field of wheel velocities brings the centre of mass of a parcel to rest."""

from __future__ import annotations

import numpy as np

from plant.array import CellArray
from plant.constants import constants_of_motion, translation_rates
from plant.continuum import linear_field
from plant.errors import PlantError
from plant.footing import moved
from plant.friction.viscous import viscous_of
from plant.specs import PlantSpec
from plant.wheels import Floats

_NOTHING = 1e-11
"""Of the largest speed: a pull that is less is rounding."""
_ATTEMPTS = 50
"""Steps from the equilibrium of one support set to that of the next."""


def resting_place(spec: PlantSpec, index: int, wheel_speed: Floats) -> Floats:
    """Where the centre of mass of a parcel comes to rest, at the angle it starts with: ``(2,)`` m.

    In a linear field that is where the field stands still, at every angle and on all supports. In others it is the
    equilibrium of the parcel's supports, then of the supports there, until they are the same; at other angles it is
    about the same. Along a line of equilibria it is the nearest.

    Args:
        spec: array, parcels and friction.
        index: which parcel.
        wheel_speed: ``(n, 2)`` m/s, of every cell.

    Raises:
        PlantError: there is none, it doesn't hold the parcel, or the supports on the way chase each other.
    """
    field = linear_field(CellArray(spec.array).positions_m, wheel_speed)
    place: Floats = np.array(spec.parcels[index].position_m)
    fastest = float(np.max(np.hypot(wheel_speed[:, 0], wheel_speed[:, 1])))
    # a pull that changes by no more than rounding from one cell to the next draws nowhere
    weak = _NOTHING * fastest / spec.array.pitch_m
    kappa = viscous_of(spec.friction, "stable orientations").rate(spec.gravity_m_s2)
    for _ in range(_ATTEMPTS):
        if field is None:
            try:
                rate, pull = _on_supports(spec, index, wheel_speed, place)
            except PlantError:
                break
        else:
            rate, pull = field.rate_per_s, field.rate_per_s @ place + field.offset_m_s
        if np.max(np.abs(pull)) <= _NOTHING * fastest:
            if np.max(translation_rates(kappa * rate, kappa).real) > _NOTHING * kappa:
                break
            return place
        place = place - np.linalg.pinv(np.where(np.abs(rate) <= weak, 0.0, rate), rcond=1e-9) @ pull
    raise PlantError(f"parcels[{index}]: from its start no point is found to which the field draws it")


def _on_supports(spec: PlantSpec, index: int, wheel_speed: Floats, place: Floats) -> tuple[Floats, Floats]:
    """Force per ``mu W`` at a place, ``(2,)`` m/s, and its gradient on the supports there, ``(2, 2)`` 1/s."""
    parcels = list(spec.parcels)
    parcels[index] = moved(parcels[index], place)
    motion = constants_of_motion(spec.model_copy(update={"parcels": tuple(parcels)}), index, wheel_speed)
    force = motion.f0_n + motion.k_s_n_per_m @ place
    return motion.k_s_n_per_m / motion.damping_n_s_per_m, force / motion.damping_n_s_per_m
