"""How commands become wheel motion, and what ideal wheels do with them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol, final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


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


class Wheels(Protocol):
    """What turns drives into wheel motion. Physics: lives in the plant, never in firmware."""

    def command(self, drives: Floats) -> WheelMotion:
        """Motion from now on under the drives ``(n, 2)``, which are the wheels' own from here on."""
        ...

    def elapse(self, motion: WheelMotion, span_s: float) -> None:
        """Let the wheels turn for ``span_s`` seconds."""
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

    def __init__(self, cells: int) -> None:
        self._still: Floats = np.zeros((cells, 2))
        self._speed: Floats = np.zeros((cells, 2))

    def command(self, drives: Floats) -> WheelMotion:
        """Motion at the commanded speed."""
        self._speed = drives
        return WheelMotion(drives, self._still, 0.0)

    def elapse(self, motion: WheelMotion, span_s: float) -> None:
        """Nothing changes while the command stands."""

    @property
    def speed(self) -> Floats:
        """``(n, 2)`` m/s, as commanded."""
        return self._speed

    @property
    def travel(self) -> None:
        """Ideal wheels have no encoders."""
        return None
