"""Parcels as kernel data: a single parcel, and all parcels of a scene in common arrays."""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]

LOG_CAPACITY: Final = 4096
"""Events of one parcel kept per call; of more, the report says how many were left out."""

# ── report: float64 (., REPORT_SIZE), a row for each parcel of a call to which something happened
WHICH: Final = 0  # its number
MOVED: Final = 1  # how far it came, s
CHANGES: Final = 2  # of its supports
LOGGED: Final = 3  # rows of the log that are its own, after those of the parcel reported before
LEFT_OUT: Final = 4  # events that the log had no room for
REPORT_SIZE: Final = 5


class Parcel(NamedTuple):
    """One parcel; see ``plant.kernels.common.layout``.

    Attributes:
        vertices: ``(v, 2)`` corners about the centre of mass, in the parcel's axes, counter-clockwise, m.
        normal: ``(v, 2)`` outward unit normals of the edges.
        offset: ``(v,)`` distance of the edges along them, m.
        par: ``(PAR_SIZE,)``.
        y: ``(6,)``.
        mem: ``(capacity, MEM_COLUMNS)``.
        ctl: ``(CTL_SIZE,)``.
    """

    vertices: Floats
    normal: Floats
    offset: Floats
    par: Floats
    y: Floats
    mem: Integers
    ctl: Integers


class Parcels(NamedTuple):
    """All parcels of a scene, so that one call of a kernel can move many.

    Attributes:
        corner: ``(m + 1,)`` where each parcel's corners begin in the next three, and where the last's end.
        vertices: as ``Parcel.vertices``, one parcel's after the other's.
        normal: likewise.
        offset: likewise.
        slot: ``(m + 1,)`` where each parcel's cells begin in ``mem``.
        mem: likewise.
        par: ``(m, PAR_SIZE)``.
        y: ``(m, 6)``.
        ctl: ``(m, CTL_SIZE)``.
    """

    corner: Integers
    vertices: Floats
    normal: Floats
    offset: Floats
    slot: Integers
    mem: Integers
    par: Floats
    y: Floats
    ctl: Integers
