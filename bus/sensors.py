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
        sensors: Presence sensors a cell.
        encoders: Whether wheels have encoders.
        levels: Whether sensors tell how much of their spot is covered.
        labels: Largest number of a label that a scanner may read; 0: there are no scanners.
        camera: Most parcels that a camera's picture may show; 0: nobody is shown any.
    """

    sensors: int
    encoders: bool = False
    levels: bool = False
    labels: int = 0
    camera: int = 0


class CameraFrame(NamedTuple):
    """Frame of a camera: poses of the parcels in view.

    Attributes:
        parcel: ``(p,)`` int64, numbers of the parcels that were there, ascending.
        pose: ``(p, 3)``, x and y of each one's centre of mass, m, and its angle, rad.
    """

    parcel: NDArray[np.int64]
    pose: NDArray[np.float64]
