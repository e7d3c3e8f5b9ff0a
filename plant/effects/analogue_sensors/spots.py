"""Coverage of analogue sensors' round spots (effect ``analogue_sensors``)."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from plant.array import CellArray
from plant.effects.analogue_sensors.spec import AnalogueSensorsSpec
from plant.kernel_data import make_parcel, pack
from plant.kernels.effects import spots_entry
from plant.parcel_spec import ParcelSpec
from plant.wheels import Floats


@final
class Spots:
    """The spots of all sensors; knows parcels by their outlines and states, whichever solver moves them.

    A level is the exact share of the disc that parcels cover; where several do, they add up, at most to 1.

    Args:
        spec: how large the spots are.
        array: where the sensors are.
        parcels: all that are there or will be fed.
    """

    def __init__(self, spec: AnalogueSensorsSpec, array: CellArray, parcels: tuple[ParcelSpec, ...]) -> None:
        self._entry: Any = spots_entry
        self._radius = spec.spot_radius_m
        self._array = array
        self._reach = float(np.max(np.hypot(array.sensors_m[:, 0], array.sensors_m[:, 1])))
        self._parcels = pack([make_parcel(parcel, array) for parcel in parcels])

    def level(self, state: Floats, there: NDArray[np.int64]) -> Floats:
        """``(n, sensors)`` levels in [0, 1].

        Args:
            state: ``(m, 6)`` of all parcels.
            there: which of them are on the surface, in the order in which their shares are added.
        """
        array, level = self._array, np.zeros((len(self._array), len(self._array.sensors_m)))
        self._parcels.y[:] = state
        self._entry.cover_spots(
            array.positions_m,
            array.grid,
            self._parcels,
            there,
            array.sensors_m,
            self._reach,
            self._radius,
            level,
        )
        return level
