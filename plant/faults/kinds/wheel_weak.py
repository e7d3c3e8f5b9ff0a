"""A wheel is weak: only a share of its drive is left, or it gets no faster than so much."""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from bus.spec import NotNegative
from plant.faults.base import WheelFault, WheelFaults


@final
class WheelWeakFault(WheelFault):
    """Wheels have a fraction of their drive, or a lower top speed."""

    kind_name: ClassVar[str] = "wheel_weak"
    kind: Literal["wheel_weak"]
    strength: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] | None = None
    """Remaining share of the drive: without motors of the speed; with motors of the voltage, and so of the stall torque
    and the no-load speed."""
    most_m_s: NotNegative | None = None
    """Top speed in either direction; with motors the no-load speed at the remaining voltage."""

    @model_validator(mode="after")
    def _weak_somehow(self) -> Self:
        if self.strength is None and self.most_m_s is None:
            raise ValueError("give strength, most_m_s, or both")
        return self

    def apply(self, cells: NDArray[np.int64], wheel_faults: WheelFaults) -> None:
        """Less of the drive acts; where several faults say so, each takes its share."""
        wheels = self.wheels(cells)
        if self.strength is not None:
            wheel_faults.factor[wheels] *= self.strength
        if self.most_m_s is not None:
            wheel_faults.most_m_s[wheels] = np.minimum(wheel_faults.most_m_s[wheels], self.most_m_s)
