"""The PI loop in floating point."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.components import WheelDriver
from cell_firmware.errors import FirmwareError
from cell_firmware.firmware import Cells, Floats, State
from cell_firmware.specs import SpeedLoopSpec
from cell_firmware.speed_loop.output import Pwm, share
from cell_firmware.speed_loop.sensing import Tachometer, Travel


@final
class SpeedLoop(WheelDriver):
    """PI with saturation and anti-windup, for both wheels of n cells.

    Each period::

        e = reference - measured
        I = I + ki e T
        u = clamp(kf reference + kp e + I, -supply, +supply)

    While u is limited the integral is conditioned instead (`conditioning`), with V the measured speed::

        I = I + b (u - kf V - I)

    It stays within ``supply + kf |V|``, V the largest there was.

    Args:
        spec: Gains.
        period_s: The control period, s.
        supply_v: What the output stage can give, V, > 0.
        tachometer: What measures the speed; None for the exact travel since the last period.
        pwm: What gives the voltage; None for an output stage that gives any.
    """

    def __init__(
        self,
        spec: SpeedLoopSpec,
        period_s: float,
        supply_v: float,
        tachometer: Tachometer | None = None,
        pwm: Pwm | None = None,
    ) -> None:
        for name, value in (("period_s", period_s), ("supply_v", supply_v)):
            if not (np.isfinite(value) and value > 0.0):
                raise FirmwareError(f"speed loop: {name} must be positive and finite, not {value}")
        self.spec = spec
        self.period_s = float(period_s)
        self.supply_v = float(supply_v)
        self._tachometer = Travel(self.period_s) if tachometer is None else tachometer
        self._pwm = pwm
        self._share = share(spec.kp_v_per_m_s, spec.ki_v_per_m * self.period_s, spec.feed_forward_v_per_m_s)

    def init(self, cells: Cells) -> State:
        """Return the initial state: integrals ``(n, 2)`` V, tachometer's state, and with PWM the duty ``(n, 2)``."""
        n = len(cells)
        state: dict[str, NDArray[Any]] = {"integral_v": np.zeros((n, 2)), **self._tachometer.init(n)}
        if self._pwm is not None:
            state["duty"] = np.zeros((n, 2), dtype=np.int32)
        return state

    def constants(self) -> NDArray[Any]:
        """Return the gains, limits, and units as a record of ``kernels.speed_loop.LOOP``."""
        from cell_firmware.kernels.speed_loop import FLOATING_POINT, LOOP

        loop, spec = np.zeros(1, dtype=LOOP), self.spec
        self._tachometer.describe(loop)
        loop["kind"], loop["period_s"], loop["supply_v"] = FLOATING_POINT, self.period_s, self.supply_v
        loop["kp"], loop["ki"], loop["share"] = spec.kp_v_per_m_s, spec.ki_v_per_m, self._share
        loop["ahead"] = spec.feed_forward_v_per_m_s
        if self._pwm is not None:
            loop["levels"] = self._pwm.levels
        return loop

    def step(self, state: State, reference_m_s: Floats, encoder_m: Floats) -> tuple[State, Floats]:
        """One control period."""
        spec = self.spec
        seen, reading = self._tachometer.read(state, encoder_m)
        measured = reading * self._tachometer.unit_m_s
        error = reference_m_s - measured
        ahead = spec.feed_forward_v_per_m_s * reference_m_s + spec.kp_v_per_m_s * error
        before = state["integral_v"]
        grown = before + spec.ki_v_per_m * error * self.period_s
        wanted = ahead + grown
        volts = np.minimum(np.maximum(wanted, -self.supply_v), self.supply_v)
        held = before + self._share * (volts - spec.feed_forward_v_per_m_s * measured - before)
        after: dict[str, NDArray[Any]] = {"integral_v": np.where(wanted == volts, grown, held), **seen}
        if self._pwm is not None:
            after["duty"] = duty = self._pwm.duty(volts)
            volts = self._pwm.volts(duty)
        return after, volts

    def registers(self, state: State) -> dict[str, NDArray[Any]]:
        """The integral terms, V; counts and duties where there are any."""
        duty = {} if self._pwm is None else {"duty": state["duty"]}
        return {"integral_v": state["integral_v"], **self._tachometer.registers(state), **duty}
