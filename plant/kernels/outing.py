"""What happens on the way of a call, and scratch for parcels that go through legs of their own; see ``way``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


class Way(NamedTuple):
    """What happens on the way of a call.

    Attributes:
        after: ``(c, n, 2)`` when wheels change; see ``plant.wheels.Changes``.
        steady: ``(c, n, 2)``.
        decay: ``(c, n, 2)``.
        reads: ``(n,)`` s after the start when cells read; infinite: not on the way.
        margin: ``(m,)`` m, how far from its footprint at the start each parcel can matter to a cell.
        sensors: ``(s, 2)`` m, from a cell's centre.
        bits: ``(n, s)``: set where a sensor is under a parcel when its cell reads.
    """

    after: Floats
    steady: Floats
    decay: Floats
    reads: Floats
    margin: Floats
    sensors: Floats
    bits: NDArray[np.bool_]


class Hand(NamedTuple):
    """Scratch of one thread.

    Attributes:
        steady: ``(n, 2)`` of the wheels as the parcel whose turn it is finds them; between turns as at the start.
        decay: likewise.
        when: ``(2 c n,)`` s, changes that can matter to it, in order.
        which: which: their index into ``Way.after``, flat.
        times: ``(n,)`` s, when cells read that it can matter to, in order.
        cells: ``(n,)`` which.
        poses: ``(n, 1, 6)`` where it is then.
    """

    steady: Floats
    decay: Floats
    when: Floats
    which: NDArray[np.int64]
    times: Floats
    cells: NDArray[np.int64]
    poses: Floats
