"""Differences of a potential across the four faces of a cell."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Bools, Floats


def across(valid: Bools, neighbour: Floats, own: Floats) -> Floats:
    """Return each neighbour's value less the cell's own, ``(n, 4)``; 0 across insulated faces, without a message.

    Args:
        valid: ``(n, 4)``, whether the neighbour's value is valid.
        neighbour: ``(n, 4)``, the neighbours' values.
        own: ``(n,)``, the cells' own values.
    """
    return np.where(valid, neighbour - own[:, None], 0.0)


def total(each: NDArray[np.float64]) -> Floats:
    """``(n,)``: the sum over the four sides, in their order."""
    return each[:, 0] + each[:, 1] + each[:, 2] + each[:, 3]


def gradient(across_faces: Floats, pitch_m: Floats) -> Floats:
    """``(n, 2)``, per metre: the mean of the slopes in the two opposite faces of a cell, an insulated one having none.

    Where both are open it is the central difference. Beside a wall the slope across it grows from 0 at the wall, and
    the mean is its value at the cell's centre to second order.

    Args:
        across_faces: ``(n, 4)``, result of ``across``.
        pitch_m: ``(n,)``.
    """
    slope = np.empty((len(across_faces), 2))
    slope[:, 0] = (across_faces[:, 1] - across_faces[:, 3]) / (2.0 * pitch_m)
    slope[:, 1] = (across_faces[:, 0] - across_faces[:, 2]) / (2.0 * pitch_m)
    return slope
