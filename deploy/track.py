"""What a picture of a run needs, wherever the run came from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Track:
    """The course of a run, from a recording or straight from the plant.

    Attributes:
        title: Of the scene.
        scene: Its name or file.
        pitch_m: Distance of neighbouring cells.
        cells: ``(row, column)`` of each cell, row-major.
        positions_m: ``(n, 2)`` centre of each cell.
        footprints_m: For each parcel ``(v, 2)`` corners about its centre of mass, in its axes.
        time_s: ``(T,)`` instants, rising.
        parcels: ``(T, m, 6)`` states at the instants.
        wheel_speeds: ``(n, 2)`` wheel speeds to draw, m/s, or None.
        events: Events of the plant, each at least ``time_s`` and ``kind``; ``parcel`` where it has one.
        faults: Faults, each at least ``time_s`` and ``kind``; ``cell`` where it has one.
        status: How the run ended; None where that is not known.
        digest: Of the run, in hexadecimal; None where there is none.
    """

    title: str
    scene: str
    pitch_m: float
    cells: Sequence[tuple[int, int]]
    positions_m: NDArray[np.float64]
    footprints_m: Sequence[NDArray[np.float64]]
    time_s: NDArray[np.float64]
    parcels: NDArray[np.float64]
    wheel_speeds: NDArray[np.float64] | None = None
    events: Sequence[Mapping[str, Any]] = ()
    faults: Sequence[Mapping[str, Any]] = ()
    status: str | None = None
    digest: str | None = None
