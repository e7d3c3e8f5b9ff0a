"""The PI loop in integers of 32 bits."""

from __future__ import annotations

from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.components import WheelDriver
from cell_firmware.firmware import Cells, Floats, State
from cell_firmware.speed_loop.output import Duties, Pwm
from cell_firmware.speed_loop.scaling import OUTPUT_BITS, Scaling
from cell_firmware.speed_loop.sensing import FRACTION_BITS, Integers, IntegerTachometer, nearest

_HALF = 1 << (OUTPUT_BITS - 1)


@final
class FixedPointLoop(WheelDriver):
    """The law of `SpeedLoop` in integers, for both wheels of n cells.

    Speeds are in Q4 of the tachometer's unit, outputs and integrals in Q12 of a level (`Scaling`)::

        e = limited(reference - measured)
        I = I + ki e
        u = saturated(kf reference + kp e + I)

    While u saturates the integral is conditioned instead (`conditioning`), with V the measured speed::

        I = I + b (limited(u - kf V) - I)

    The integral saturates at the supply. Products are rounded to the nearest, but for the one with b: away from zero,
    so that the integral gets there. Floating point is only in reading the disc and the reference, and in writing volts.

    Args:
        scaling: Gains and limits.
        tachometer: What measures the speed; the one of ``scaling``.
        pwm: What gives the voltage, of as many levels; None for an output stage that gives any step of Q12.
    """

    def __init__(self, scaling: Scaling, tachometer: IntegerTachometer, pwm: Pwm | None = None) -> None:
        self.scaling = scaling
        self._tachometer = tachometer
        self._pwm = pwm

    def init(self, cells: Cells) -> State:
        """Return the initial state: integrals ``(n, 2)`` Q12, tachometer's state, and with PWM the duty ``(n, 2)``."""
        n = len(cells)
        state: dict[str, NDArray[Any]] = {
            "integral": np.zeros((n, 2), dtype=np.int32),
            **self._tachometer.init(n),
        }
        if self._pwm is not None:
            state["duty"] = np.zeros((n, 2), dtype=np.int32)
        return state

    def constants(self) -> NDArray[Any]:
        """Return the gains, limits, and units as a record of ``kernels.speed_loop.LOOP``."""
        from cell_firmware.kernels.speed_loop import FIXED_POINT, LOOP

        loop, scaling = np.zeros(1, dtype=LOOP), self.scaling
        self._tachometer.describe(loop)
        loop["kind"], loop["step_m_s"] = FIXED_POINT, self._tachometer.step_m_s
        for name in ("volts_per_step", "reference_limit", "error_limit", "output_limit"):
            loop[name] = getattr(scaling, name)
        gains = {"kp": scaling.kp, "ki": scaling.ki, "ahead": scaling.feed_forward, "share": scaling.share}
        for name, gain in gains.items():
            loop[f"{name}_word"], loop[f"{name}_shift"] = gain.word, gain.shift
        if self._pwm is not None:
            loop["levels"], loop["supply_v"] = self._pwm.levels, self._pwm.supply_v
        return loop

    def step(self, state: State, reference_m_s: Floats, encoder_m: Floats) -> tuple[State, Floats]:
        """One control period."""
        tachometer = self._tachometer
        seen, reading = tachometer.read(state, encoder_m)
        measured = reading << (FRACTION_BITS - tachometer.fraction_bits)
        reference = nearest(reference_m_s / tachometer.step_m_s, self.scaling.reference_limit)
        integral, output = self.act(state["integral"], reference, measured)
        after: dict[str, NDArray[Any]] = {"integral": integral, **seen}
        if self._pwm is None:
            return after, output.astype(np.float64) * self.scaling.volts_per_step
        after["duty"] = duty = whole_levels(output)
        return after, self._pwm.volts(duty)

    def act(self, integral: Integers, reference: Integers, measured: Integers) -> tuple[Integers, Integers]:
        """The law alone: the next integral and the output, Q12, from an integral and two speeds in Q4; all int32."""
        scaling = self.scaling
        error = _within(reference - measured, scaling.error_limit)
        grown = integral + scaling.ki.times(error)
        wanted = scaling.feed_forward.times(reference) + scaling.kp.times(error) + grown
        output = _within(wanted, scaling.output_limit)
        after = _within(grown, scaling.output_limit)
        saturated = wanted != output
        if saturated.any():  # spares the time, and changes no bits
            after = np.where(saturated, self._conditioned(integral, output, measured), after)
        return after, output

    def _conditioned(self, integral: Integers, output: Integers, measured: Integers) -> Integers:
        scaling = self.scaling
        ahead = scaling.feed_forward.times(_within(measured, scaling.reference_limit))
        holding = _within(output - ahead, scaling.output_limit)
        return integral + scaling.share.away_from_zero(holding - integral)

    def registers(self, state: State) -> dict[str, NDArray[Any]]:
        """The integrals; counts and duties where there are any."""
        duty = {} if self._pwm is None else {"duty": state["duty"]}
        return {"integral": state["integral"], **self._tachometer.registers(state), **duty}


def whole_levels(output: Integers) -> Duties:
    """An output in Q12 as whole levels: sign and magnitude, the magnitude rounded to the nearest, ties up."""
    levels = (np.abs(output) + _HALF) >> OUTPUT_BITS
    return np.where(output < 0, -levels, levels)


def _within(value: Integers, limit: int) -> Integers:
    return np.minimum(np.maximum(value, -limit), limit)
