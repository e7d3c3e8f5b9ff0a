"""What faults of wheels have in common: which wheels of which cells they strike."""

from __future__ import annotations

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from bus.fault import CellTarget
from plant.faults.fault import PlantFault


class WheelFault(CellTarget, PlantFault):
    """A fault of wheels of cells."""

    wheel: Literal["x", "y", "both"] = "both"
    """The one that moves parcels along x, the one along y, or both."""

    def wheels(self, cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], slice]:
        """Rows and columns of those that it strikes, in an array ``(n, 2)`` of all wheels."""
        return cells, {"x": slice(0, 1), "y": slice(1, 2), "both": slice(0, 2)}[self.wheel]
