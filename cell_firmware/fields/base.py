"""What every velocity field is."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from cell_firmware.specs import Spec

Array = NDArray[np.float64]


class Field(Spec):
    """A field of surface velocities over the array, constant in time.

    A subclass adds ``kind: Literal["its_name"] = "its_name"`` and its parameters. Values must come from
    elementwise ``+ - * /`` and ``np.sqrt`` alone: these give the same bits for one cell and for many.
    """

    @abstractmethod
    def velocity(self, x: Array, y: Array) -> Array:
        """Surface velocity at each position.

        Args:
            x: ``(n,)``, m.
            y: ``(n,)``, m.

        Returns:
            ``(n, 2)``, m/s.
        """


def columns(vx: Array, vy: Array) -> Array:
    """Two ``(n,)`` components as one ``(n, 2)`` array."""
    return np.stack((vx, vy), axis=1)


def unit(x: Array, y: Array) -> tuple[Array, Array]:
    """Unit vectors towards ``(x, y)``; zero at the origin, where there is no direction."""
    distance = np.sqrt(x * x + y * y)
    divisor = np.where(distance > 0.0, distance, 1.0)
    return x / divisor, y / divisor
