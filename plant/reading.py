"""What cells read in one call of the plant, each at an instant of its own."""

from __future__ import annotations

from typing import final

import numpy as np
from numpy.typing import NDArray

from plant.reports import Sense
from plant.timing import Timing
from plant.wheels import Floats


@final
class Reading:
    """Collects what cells read; one that doesn't read keeps what it read last.

    Args:
        last: what each cell read last; kept as it is.
        start: what all would read as the call begins.
        timing: when each reads.
        now_ns: when the call begins.
        until_ns: when it ends.

    Attributes:
        instants_s: ``(n,)`` s after the call's start; infinite for cells that don't read within it.
    """

    def __init__(self, last: Sense, start: Sense, timing: Timing, now_ns: int, until_ns: int) -> None:
        self.instants_s: Floats = timing.reads_s(now_ns, until_ns)
        self._at_end = timing.reads_ns == until_ns
        inside = np.isfinite(self.instants_s)
        self.any_inside = bool(inside.any())
        self._presence = last.presence.copy()
        # who reads sees a parcel only where one is near: those cells are told below
        self._presence[inside] = False
        self._encoder_m = None if last.encoder_m is None else last.encoder_m.copy()
        at_start = timing.reads_ns == now_ns
        self._presence[at_start] = start.presence[at_start]
        self._level = None if last.level is None else last.level.copy()
        if self._level is not None and start.level is not None:
            self._level[inside] = 0.0
            self._level[at_start] = start.level[at_start]
        if self._encoder_m is not None and start.encoder_m is not None:
            self._encoder_m[at_start] = start.encoder_m[at_start]
        self._inside = inside

    @property
    def asked_s(self) -> Floats:
        """``(n,)`` ``instants_s``, the start for those that don't read on the way."""
        return np.where(self._inside, self.instants_s, 0.0)

    def turned(self, encoder_m: Floats | None) -> None:
        """Take what encoders show ``(n, 2)``, each cell's at its instant."""
        if self._encoder_m is not None and encoder_m is not None:
            self._encoder_m[self._inside] = encoder_m[self._inside]

    def at(self, now_s: float, sense: Sense, slowed_m: Floats | None) -> None:
        """Let those read whose instant it is.

        Args:
            now_s: s after the call's start.
            sense: what all would read now; its encoders are not looked at.
            slowed_m: ``(n, 2)`` what loads have taken from the wheels' way since the start; None: nothing.
        """
        now = self.instants_s == now_s
        self._presence[now] = sense.presence[now]
        if self._level is not None and sense.level is not None:
            self._level[now] = sense.level[now]
        if self._encoder_m is not None and slowed_m is not None:
            self._encoder_m[now] += slowed_m[now]

    def saw(self, presence: NDArray[np.bool_]) -> None:
        """Take what sensors ``(n, sensors)`` see, each cell's at its instant."""
        self._presence[self._inside] = presence[self._inside]

    def sense(self, end: Sense) -> Sense:
        """What each cell has read, ``end`` being what all would read at the end."""
        at_end = self._at_end
        self._presence[at_end] = end.presence[at_end]
        if self._level is not None and end.level is not None:
            self._level[at_end] = end.level[at_end]
        if self._encoder_m is not None and end.encoder_m is not None:
            self._encoder_m[at_end] = end.encoder_m[at_end]
            self._encoder_m.setflags(write=False)
        return Sense(self._presence, self._encoder_m, self._level)
