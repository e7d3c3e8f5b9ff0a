"""Pace of a run that keeps step with the wall clock, and warnings when it can't."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Final, final

_LAG_S: Final = 0.5
"""Lag at which a run is said to fall behind, wall seconds; shorter ones are jitter."""
_CAUGHT_UP_S: Final = 0.05
"""Lag at which a run that fell behind has caught up, wall seconds."""


@final
class Pace:
    """Waits, before a tick, until its simulated time has come on the wall clock.

    A run that is late doesn't wait until it has caught up. Its lag is reported once it matters, again whenever it has
    doubled, and when it is made up for.

    Args:
        factor: Simulated seconds a wall second.
        warn: Takes one line.
        clock: Monotonic wall time, s.
        sleep: Waits so many seconds.

    Attributes:
        factor: As given.
        lag_s: Lag behind the clock before the last tick, wall seconds; 0 in step with it.
    """

    def __init__(
        self,
        factor: float,
        warn: Callable[[str], None],
        *,
        clock: Callable[[], float] = time.monotonic,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self.factor = factor
        self.lag_s = 0.0
        self._warn = warn
        self._clock = clock
        self._sleep = sleep
        self._begun: float | None = None
        self._from_s = 0.0
        self._next_lag_s = _LAG_S

    def __call__(self, start_ns: int) -> None:
        """Wait for the start of a tick, ns of simulated time."""
        start_s, now = start_ns * 1e-9, self._clock()
        if self._begun is None:
            self._begun, self._from_s = now, start_s
        lag_s = now - self._begun - (start_s - self._from_s) / self.factor
        self.lag_s = max(lag_s, 0.0)
        if lag_s < 0:
            self._sleep(-lag_s)
        if lag_s >= self._next_lag_s:
            self._report(start_s, lag_s, now - self._begun)
        elif lag_s <= _CAUGHT_UP_S and self._next_lag_s > _LAG_S:
            self._warn(f"--realtime {self.factor:g}: in step with the clock again at {start_s:.3f} s")
            self._next_lag_s = _LAG_S

    def restart(self) -> None:
        """Keep step with the clock from the next tick on, whatever the lag was."""
        self._begun, self._next_lag_s, self.lag_s = None, _LAG_S, 0.0

    def _report(self, start_s: float, lag_s: float, wall_s: float) -> None:
        """Report the lag, and the pace of the run so far."""
        while self._next_lag_s <= lag_s:
            self._next_lag_s *= 2
        rate = (start_s - self._from_s) / wall_s
        self._warn(
            f"--realtime {self.factor:g}: can't keep up: {lag_s:.1f} s behind the clock at {start_s:.3f} s "
            f"({rate:.2g} × real time so far)"
        )
