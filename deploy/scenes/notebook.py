"""A scene in a notebook: the array with the parcels where they start."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deploy.util.notebook import array_svg
from plant.array import CellArray
from plant.geometry import centroid, counter_clockwise, placed
from plant.parcel_spec import ArraySpec, ParcelSpec


def start_svg(spec: ArraySpec, parcels: Sequence[ParcelSpec]) -> str:
    """Return a view from above of an array and of parcels at their start, as an SVG element."""
    array = CellArray(spec)
    outlines: list[NDArray[np.float64]] = []
    for parcel in parcels:
        corners = counter_clockwise(parcel.polygon())
        centre = parcel.centre_of_mass_m or centroid(parcel.polygon())
        outlines.append(placed(corners - np.array(centre), np.array([*parcel.position_m, parcel.angle_rad])))
    return array_svg(array.positions_m, array.pitch_m, outlines)
