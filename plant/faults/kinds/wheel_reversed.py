"""A wheel's leads are swapped: it turns the other way than it is driven."""

from __future__ import annotations

from typing import ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray

from plant.faults.base import WheelFault, WheelFaults


@final
class WheelReversedFault(WheelFault):
    """Wheels turn against their drives. Encoders report the true direction, so that speed loops accelerate."""

    kind_name: ClassVar[str] = "wheel_reversed"
    kind: Literal["wheel_reversed"]

    def apply(self, cells: NDArray[np.int64], wheel_faults: WheelFaults) -> None:
        """Drives act the other way."""
        wheel_faults.factor[self.wheels(cells)] *= -1.0
