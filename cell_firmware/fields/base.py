"""Base class of velocity fields."""

from __future__ import annotations

from abc import abstractmethod

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from cell_firmware.errors import ParametersError, Problem
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

    def check_places(self, firmware: str, lattice: Lattice, position_m: Array) -> None:
        """Refuses a field that is no number somewhere, as a firmware's parameter ``field``.

        Args:
            firmware: Whose parameter it is.
            lattice: The cells.
            position_m: ``(n, 2)``, centre of each, m.

        Raises:
            ParametersError: At some cell it is not finite; names the first.
        """
        speed = self.velocity(position_m[:, 0], position_m[:, 1])
        bad: list[int] = np.flatnonzero(~np.isfinite(speed).all(axis=1)).tolist()
        if not bad:
            return
        (row, column), (x, y) = lattice.cells[bad[0]], position_m[bad[0]].tolist()
        vx, vy = speed[bad[0]].tolist()
        others = f", and at {len(bad) - 1} more" if len(bad) > 1 else ""
        rule = (
            f"is ({vx:g}, {vy:g}) m/s at cell [{row}, {column}], x = {x:g}, y = {y:g}{others}: must be finite"
        )
        raise ParametersError(firmware, (Problem(("field",), rule, self.model_dump(mode="json")),))


def columns(vx: Array, vy: Array) -> Array:
    """Two ``(n,)`` components as one ``(n, 2)`` array."""
    return np.stack((vx, vy), axis=1)


def unit(x: Array, y: Array) -> tuple[Array, Array]:
    """Unit vectors towards ``(x, y)``; zero at the origin, where there is no direction."""
    distance = np.sqrt(x * x + y * y)
    divisor = np.where(distance > 0.0, distance, 1.0)
    return x / divisor, y / divisor
