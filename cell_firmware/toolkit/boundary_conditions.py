"""Initial and boundary conditions of protocols that spread a speed over the array."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from cell_firmware.errors import ParametersError
from cell_firmware.firmware import Bools, Floats, Inbox
from cell_firmware.specs import Spec, Vector
from cell_firmware.toolkit.graph import GraphLaplacian
from cell_firmware.toolkit.regions import RegionVelocity, assign, region_problems


class InitialAndHeld(Spec):
    """Initial speeds of cells, and speeds of held cells."""

    speed_m_s: Vector = (0.0, 0.0)
    """Speed that every cell starts with, unless ``initial`` or ``held`` names it."""
    initial: tuple[RegionVelocity, ...] = ()
    """Cells that start with another speed."""
    held: tuple[RegionVelocity, ...] = ()
    """Cells that keep their speed: the boundary condition."""

    def start(self, row: NDArray[np.int64], column: NDArray[np.int64]) -> tuple[Floats, Bools]:
        """Speeds ``(n, 2)`` m/s of the cells in these rows and columns, and which of them are held."""
        speed = np.empty((len(row), 2))
        speed[:] = self.speed_m_s
        assign(self.initial, row, column, speed)
        return speed, assign(self.held, row, column, speed)

    def range_m_s(self) -> dict[str, tuple[float, float]]:
        """The least and the greatest speed that any cell starts with, of each component by its field's name."""
        speeds = [self.speed_m_s, *(place.speed_m_s for place in (*self.initial, *self.held))]
        components = zip(("vx_m_s", "vy_m_s"), zip(*speeds, strict=True), strict=True)
        return {name: (min(values), max(values)) for name, values in components}

    def laplacian(self, lattice: Lattice) -> GraphLaplacian:
        """Return the graph Laplacian of the array, with held cells as the boundary."""
        return GraphLaplacian(lattice, self.start(lattice.rows, lattice.columns)[1])

    def check(self, firmware: str, lattice: Lattice) -> None:
        """Refuses places that the array does not have, and cells that a list names twice.

        Raises:
            ParametersError: There are some.
        """
        problems = region_problems(lattice, {"initial": self.initial, "held": self.held})
        if problems:
            raise ParametersError(firmware, problems)


def expand_ranges(ranges: Mapping[str, tuple[float, float]], share: float) -> dict[str, tuple[float, float]]:
    """Ranges with so many times the greatest amount in each more at either end."""
    more = {name: share * max(abs(low), abs(high)) for name, (low, high) in ranges.items()}
    return {name: (low - more[name], high + more[name]) for name, (low, high) in ranges.items()}


def message_speeds(inbox: Inbox) -> Floats:
    """The speeds in messages of ``vx_m_s`` and ``vy_m_s``, ``(n, 4, 2)``."""
    return np.stack((inbox.message["vx_m_s"], inbox.message["vy_m_s"]), axis=2)
