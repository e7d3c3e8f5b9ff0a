"""Effect ``motors``: each wheel follows its voltage with a first-order lag.

``dV/dt = (gain u - V) / tau``: a speed-controlled DC motor without load (the paper's motor model with the coil's
inductance neglected; the parcel's reaction is the effect ``wheel_load``). Integrated in closed form, so a period of any
length is exact.
"""

from __future__ import annotations

import math
from typing import ClassVar, Self, final

import numpy as np

from bus.effect import EffectSpec
from bus.spec import Positive
from plant.wheels import Changes, Floats, WheelMotion, WheelRun


@final
class MotorsSpec(EffectSpec):
    """First-order motors: ``dV/dt = (gain u - V) / time constant``, one per wheel."""

    states: ClassVar[tuple[str, ...]] = ("speed and travel of every wheel", "integral of every speed loop")
    messages: ClassVar[tuple[str, ...]] = ("cells are told encoder counts", "drives are volts")
    rung: ClassVar[int | None] = 30
    time_constant_s: Positive = 0.06
    speed_per_volt_m_s: Positive = 0.1
    """No-load surface speed per volt."""
    supply_v: Positive = 12.0
    """Commands saturate at plus and minus this voltage."""

    @classmethod
    def typical(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """The defaults."""
        return cls()


@final
class Motors:
    """First-order motors of all wheels; drives are volts, saturated at the supply.

    Args:
        spec: Time constant, gain and supply.
        cells: Number of cells.
        loaded: Whether they feel what they pull (effect ``wheel_load``).
    """

    def __init__(self, spec: MotorsSpec, cells: int, *, loaded: bool = False) -> None:
        self._spec = spec
        self._loaded = loaded
        self._rate = 1.0 / spec.time_constant_s
        self._towards: Floats = np.zeros((cells, 2))
        self._speed: Floats = np.zeros((cells, 2))
        self._travel: Floats = np.zeros((cells, 2))

    def command(self, drives: Floats, span_s: float, acts_s: Floats | None = None) -> WheelRun:  # noqa: ARG002
        """Motion towards the no-load speed of the voltages; see ``plant.wheels.Wheels``."""
        limit = self._spec.supply_v
        steady = self._spec.speed_per_volt_m_s * np.minimum(np.maximum(drives, -limit), limit)
        slowing = np.zeros((len(steady), 4)) if self._loaded else None
        before, self._towards = self._towards, steady
        if acts_s is None:
            return WheelRun(WheelMotion(steady, self._speed - steady, self._rate, slowing))
        late = (acts_s > 0.0)[:, None] & (steady != before)
        first = np.where(late, before, steady)
        motion = WheelMotion(first, self._speed - first, self._rate, slowing)
        wheel = np.flatnonzero(late)
        after = acts_s[wheel // 2]
        then = motion.steady[late] + motion.decay[late] * np.exp(-self._rate * after)
        return WheelRun(motion, Changes.of(after, wheel, steady[late], then - steady[late]))

    def elapse(self, run: WheelRun, span_s: float) -> None:
        """Take speed and travel ``span_s`` seconds along ``run``."""
        motion = run.motion
        if run.changes is None:
            left = math.exp(-motion.rate * span_s)
            covered = -math.expm1(-motion.rate * span_s) / motion.rate
            self._travel = self._travel + motion.steady * span_s + motion.decay * covered
            self._speed = motion.steady + motion.decay * left
        else:
            self._travel = self._travel + run.way(span_s)
            self._speed = run.speed(span_s)
        if motion.slowing is not None:
            self._speed += motion.slowing[:, :2]
            self._travel += motion.slowing[:, 2:]

    def passed(self, run: WheelRun, after_s: Floats) -> Floats:
        """``travel`` as it will be ``(n,)`` seconds from now, but for what loads take from it on the way."""
        return self._travel + run.way(after_s)

    @property
    def speed(self) -> Floats:
        """``(n, 2)`` m/s."""
        return self._speed

    @property
    def travel(self) -> Floats:
        """``(n, 2)`` m of surface passed since the start."""
        return self._travel
