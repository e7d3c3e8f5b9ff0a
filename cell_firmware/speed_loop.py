"""The PI loop that makes a motor's wheel follow a speed, in floating point."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.errors import FirmwareError
from cell_firmware.firmware import Cells, Floats, State
from cell_firmware.parts import WheelPart
from cell_firmware.specs import SpeedLoopSpec


@final
class SpeedLoop(WheelPart):
    """PI with saturation and anti-windup, for both wheels of n cells.

    Measured speed is the encoder's travel since the last tick over the period (0 at the first reading)::

        e = reference - measured
        I = I + ki e T
        u = clamp(kf reference + kp e + I, -supply, +supply)

    While the sum is beyond the supply in the error's direction the integral is remembered as it was, so that
    a wheel that can't follow does not wind it up.

    Args:
        spec: Gains.
        period_s: The control period, s.
        supply_v: What the output stage can give, V, > 0.
    """

    def __init__(self, spec: SpeedLoopSpec, period_s: float, supply_v: float) -> None:
        for name, value in (("period_s", period_s), ("supply_v", supply_v)):
            if not (np.isfinite(value) and value > 0.0):
                raise FirmwareError(f"speed loop: {name} must be positive and finite, not {value}")
        self.spec = spec
        self.period_s = float(period_s)
        self.supply_v = float(supply_v)

    def init(self, cells: Cells) -> State:
        """Integral terms ``(n, 2)`` V, the last readings ``(n, 2)`` m, and whether there was one, ``(n, 1)``."""
        n = len(cells)
        return {
            "integral_v": np.zeros((n, 2)),
            "encoder_m": np.zeros((n, 2)),
            "seen": np.zeros((n, 1), dtype=np.bool_),
        }

    def step(self, state: State, reference_m_s: Floats, encoder_m: Floats) -> tuple[State, Floats]:
        """One control period."""
        spec = self.spec
        measured = np.where(state["seen"], (encoder_m - state["encoder_m"]) / self.period_s, 0.0)
        error = reference_m_s - measured
        ahead = spec.feed_forward_v_per_m_s * reference_m_s + spec.kp_v_per_m_s * error
        grown = state["integral_v"] + spec.ki_v_per_m * error * self.period_s
        wanted = ahead + grown
        winding = ((wanted > self.supply_v) & (error > 0.0)) | ((wanted < -self.supply_v) & (error < 0.0))
        integral = np.where(winding, state["integral_v"], grown)
        volts = np.minimum(np.maximum(wanted, -self.supply_v), self.supply_v)
        after = {"integral_v": integral, "encoder_m": encoder_m.copy(), "seen": np.ones_like(state["seen"])}
        return after, volts

    def registers(self, state: State) -> dict[str, NDArray[Any]]:
        """The integral terms, V."""
        return {"integral_v": state["integral_v"]}
