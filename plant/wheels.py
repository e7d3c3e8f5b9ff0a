"""Interface of wheel models: drives to wheel motion. Includes ideal wheels."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal, NamedTuple, Protocol, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields

Floats = NDArray[np.float64]
LossPolicy = Literal["coast", "brake", "hold"]
"""What the wheels of a dead cell do."""


@final
@dataclass(frozen=True, slots=True)
class WheelMotion:
    """Surface velocity of every cell over an interval: ``steady + decay exp(-rate t)``.

    Attributes:
        steady: ``(n, 2)`` m/s.
        decay: ``(n, 2)`` m/s.
        rate: 1/s; 0 where nothing decays.
        slowing: ``(n, 4)`` where wheels feel what they pull: what that adds to speed along x and y, m/s, and to way,
            m, by the end of the interval. The solver fills it in.
    """

    steady: Floats
    decay: Floats
    rate: float
    slowing: Floats | None = None


class WheelChanges(NamedTuple):
    """Changes of single wheels' motion within an interval, at most c a wheel, each at its own instant.

    Attributes:
        after_s: times of the changes from the start of the interval, ascending for every wheel, ``(c, n, 2)``, s;
            infinite: fewer changes.
        steady: ``(c, n, 2)`` m/s: the wheel continues at ``steady + decay exp(-rate t)``, t from ``after_s``.
        decay: ``(c, n, 2)`` m/s.
    """

    after_s: Floats
    steady: Floats
    decay: Floats


@final
@dataclass(frozen=True)
class WheelRun:
    """Closed-form motion of all wheels over an interval.

    Attributes:
        motion: motion from the start of the interval.
        changes: changes of single wheels within the interval; None without changes.
    """

    motion: WheelMotion
    changes: WheelChanges | None = None

    @cached_property
    def fastest_m_s(self) -> float:
        """Speed that no cell's two wheels exceed together."""
        # a wheel's speed stays between that with which it begins and those that it goes towards
        speeds = [self.motion.steady, self.motion.steady + self.motion.decay]
        if self.changes is not None:
            speeds.append(self.changes.steady)
        most = max(max(float(speed.max(initial=0.0)), -float(speed.min(initial=0.0))) for speed in speeds)
        return math.sqrt(2.0) * most


def _exp(x: Floats) -> Floats:
    """Return the exponential of each element, from the C library as kernels have it (``bus.elementary`` tells why)."""
    from plant.kernels.wheels import entry  # loads numba: only where wheels lag

    kernels: Any = entry
    values = np.ascontiguousarray(x)
    found = np.empty_like(values)
    kernels.exp_of_each(values.reshape(-1), found.reshape(-1))
    return found


@final
class WheelIntegrator:
    """Wheel motion of a run segment by segment.

    Args:
        run: motion of all wheels; speed losses by loads in the segments are added to its ``slowing``.
    """

    def __init__(self, run: WheelRun) -> None:
        self._run = run
        self._steady, self._decay = run.motion.steady.copy(), run.motion.decay.copy()
        self._now_s = 0.0
        self._begun_s = -math.inf
        self._slowed: Floats | None = run.motion.slowing

    def begin(self) -> WheelMotion:
        """The motion from now on; valid until a leg begins later."""
        rate, change, slowed = self._run.motion.rate, self._run.changes, self._slowed
        if change is not None:
            for begun, steady, decay in zip(*change, strict=True):
                new = (begun > self._begun_s) & (begun <= self._now_s)
                self._steady[new] = steady[new]
                self._decay[new] = decay[new] * _exp(-rate * (self._now_s - begun[new]))
                if slowed is not None:
                    self._decay[new] += slowed[:, :2][new]
        self._begun_s = self._now_s
        slowing = None if slowed is None else np.zeros_like(slowed)
        return WheelMotion(self._steady, self._decay, rate, slowing)

    def end(self, motion: WheelMotion, now_s: float) -> None:
        """Take the wheels along the leg's motion to ``now_s``."""
        rate, span_s = motion.rate, now_s - self._now_s
        if rate:
            self._decay *= math.exp(-rate * span_s)
        if self._slowed is not None and motion.slowing is not None:
            self._slowed[:, 2:] -= self._slowed[:, :2] * (math.expm1(-rate * span_s) / rate)
            self._slowed[:, :2] *= math.exp(-rate * span_s)
            self._slowed += motion.slowing
            self._decay += motion.slowing[:, :2]
        self._now_s = now_s

    @property
    def slowed_m(self) -> Floats | None:
        """``(n, 2)`` what loads have taken from the wheels' way until now; None where they don't."""
        return None if self._slowed is None else self._slowed[:, 2:]


class Wheels(Protocol):
    """Model of wheels that converts drives to wheel motion. Part of the plant, never of firmware."""

    def command(self, drives: Floats, span_s: float, acts_s: Floats | None = None) -> WheelRun:
        """Apply drives and return the wheels' motion for ``span_s`` seconds.

        Args:
            drives: drives of all wheels, ``(n, 2)``. The wheels take ownership of the array.
            span_s: duration of the drives, s.
            acts_s: time at which each cell's drives take effect, ``(n,)``, s, in ``[0, span_s)``. The previous drives
                act until then. None: all take effect now.
        """
        ...

    def elapse(self, run: WheelRun, span_s: float, reads_s: Floats | None = None) -> Floats | None:
        """Let the wheels turn for ``span_s`` seconds.

        Args:
            run: what they do, and what loads took from them by the end.
            span_s: how long.
            reads_s: ``(n,)`` in ``[0, span_s]``: when each cell's encoders are read on the way; None: at no time.

        Returns:
            ``travel`` ``(n, 2)`` as it is then, but for what loads take from it; None if not read, or as ``travel``.
        """
        ...

    @property
    def speed(self) -> Floats:
        """``(n, 2)`` m/s, now."""
        ...

    @property
    def travel(self) -> Floats | None:
        """``(n, 2)`` m of surface passed since the start: what an encoder counts; None without encoders."""
        ...


@final
class IdealWheels:
    """Wheels that run at the commanded surface speed at once; drives are m/s."""

    state_fields: ClassVar[StateFields] = StateFields("_speed")

    def __init__(self, cells: int) -> None:
        self._still: Floats = np.zeros((cells, 2))
        self._speed: Floats = np.zeros((cells, 2))

    def command(self, drives: Floats, span_s: float, acts_s: Floats | None = None) -> WheelRun:  # noqa: ARG002
        """Motion at the commanded speed; see `Wheels`."""
        before, self._speed = self._speed, drives
        if acts_s is None:
            return WheelRun(WheelMotion(drives, self._still, 0.0))
        late = (acts_s > 0.0)[:, None] & (drives != before)
        if not late.any():
            return WheelRun(WheelMotion(drives, self._still, 0.0))
        after = np.where(late, acts_s[:, None], np.inf)
        changes = WheelChanges(after[None], drives[None], self._still[None])
        return WheelRun(WheelMotion(np.where(late, before, drives), self._still, 0.0), changes)

    def elapse(self, run: WheelRun, span_s: float, reads_s: Floats | None = None) -> None:
        """Nothing is left to do: they are at the commanded speed, and have no encoders."""

    @property
    def speed(self) -> Floats:
        """``(n, 2)`` m/s, as commanded."""
        return self._speed

    @property
    def travel(self) -> None:
        """Ideal wheels have no encoders."""
        return None
