"""Fault ``slow_clock``: a cell's program runs in some of its control periods only."""

from __future__ import annotations

from fractions import Fraction
from typing import Annotated, ClassVar, Final, Literal, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, field_validator

from bus.fault import CellTarget
from cell_firmware.faults.base import CellFault
from cell_firmware.firmware import Bools

_PLACES: Final = 10**6


@final
class SlowClockFault(CellTarget, CellFault):
    """Programs run in a share ``factor`` of the control periods, as if their cells were too slow.

    Of the periods m = 0, 1, 2, ... since the fault's start, programs run in those with
    ``floor((m + 1) factor) > floor(m factor)``: in any interval, the share holds to within one period. The computation
    is exact in integers. In the other periods pins are held, nothing is sent, and the watchdog does not count either.
    """

    kind_name: ClassVar[str] = "slow_clock"
    skips_periods: ClassVar[bool] = True
    kind: Literal["slow_clock"] = "slow_clock"
    factor: Annotated[float, Field(gt=0, lt=1, allow_inf_nan=False)]
    """Share of the control periods in which a program runs; at most six decimal places."""

    @field_validator("factor")
    @classmethod
    def _few_places(cls, value: float) -> float:
        if (Fraction(repr(value)) * _PLACES).denominator != 1:
            raise ValueError("must have at most six decimal places")
        return value

    def running_periods(self, period: NDArray[np.int64]) -> Bools:
        """Return the periods m in which the whole part of ``m factor`` increases."""
        share = Fraction(repr(self.factor))
        over = period % share.denominator * share.numerator % share.denominator
        return over + share.numerator >= share.denominator
