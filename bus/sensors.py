"""Sensor schema of a run: readings beyond clocks and neighbours' messages, agreed on by both sides."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

MOST_LABELS: Final = 2**16 - 1
"""Largest number that a label may be."""


Labels = NDArray[np.int64]


@final
@dataclass(frozen=True, slots=True)
class SensorSchema:
    """Sensors that exist in a run; readings of other sensors have no field on the bus.

    Attributes:
        sensors: Presence sensors of a cell.
        encoders: Whether wheels have encoders.
        levels: Whether sensors measure which share of their spot is covered.
        labels: Largest number of a label; 0: there are no scanners.
        camera: Largest number of parcels in a camera frame; 0: there is no camera.
    """

    sensors: int
    encoders: bool = False
    levels: bool = False
    labels: int = 0
    camera: int = 0


class CameraFrame(NamedTuple):
    """Frame of a camera: poses of the parcels in view.

    Attributes:
        parcel: ``(p,)`` int64, numbers of the parcels in view, ascending.
        pose: ``(p, 3)``, x and y of each parcel's centre of mass, m, and angle, rad.
    """

    parcel: NDArray[np.int64]
    pose: NDArray[np.float64]
