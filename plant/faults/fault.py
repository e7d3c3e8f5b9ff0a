"""What faults of the plant's parts are made of."""

from __future__ import annotations

from dataclasses import dataclass
from typing import final

import numpy as np
from numpy.typing import NDArray

from bus.fault import FaultSpec

Bools = NDArray[np.bool_]


@final
@dataclass(slots=True)
class Harm:
    """What faults do to the plant's parts from one tick on; each fault adds its own.

    Attributes:
        dead: ``(n,)``: do the cell's wheels get no drive any more? They do what the stall policy says.
    """

    dead: Bools

    @staticmethod
    def none(cells: int) -> Harm:
        """All is well."""
        return Harm(np.zeros(cells, dtype=np.bool_))


class PlantFault(FaultSpec):
    """A fault of what lives in the plant."""

    def harm(self, cells: NDArray[np.int64], harm: Harm) -> None:
        """Say what is the matter while it acts.

        Args:
            cells: Those that it strikes, by index.
            harm: To be changed.
        """
        raise NotImplementedError
