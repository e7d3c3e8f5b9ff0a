"""Differences of a potential across the four faces of a cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Bools, Floats


def across(heard: Bools, told: Floats, own: Floats) -> Floats:
    """``(n, 4)``: each neighbour's value less the cell's own, 0 where none is heard: that face is insulated.

    Args:
        heard: ``(n, 4)``.
        told: ``(n, 4)``, what each side told.
        own: ``(n,)``.
    """
    return np.where(heard, told - own[:, None], 0.0)


def total(each: NDArray[np.float64]) -> Floats:
    """``(n,)``: the sum over the four sides, in their order."""
    return each[:, 0] + each[:, 1] + each[:, 2] + each[:, 3]


def gradient(across_faces: Floats, pitch_m: Floats) -> Floats:
    """``(n, 2)``, per metre: the mean of the slopes in the two opposite faces of a cell, an insulated one having none.

    Where both are open it is the central difference. Beside a wall the slope across it grows from 0 at the wall, and
    the mean is its value at the cell's centre to second order.

    Args:
        across_faces: ``(n, 4)``, what ``across`` says.
        pitch_m: ``(n,)``.
    """
    slope = np.empty((len(across_faces), 2))
    slope[:, 0] = (across_faces[:, 1] - across_faces[:, 3]) / (2.0 * pitch_m)
    slope[:, 1] = (across_faces[:, 0] - across_faces[:, 2]) / (2.0 * pitch_m)
    return slope
