"""Position of a viewer in the instants of a source, and its movement."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, final

import numpy as np

if TYPE_CHECKING:
    from deploy.view.source import RunSource

SPEEDS: Final = (0.1, 0.25, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Speeds that the page offers, simulated seconds a wall second."""


@final
class Player:
    """Plays the instants of a source at a speed, forwards or backwards, or follows a run in progress.

    Args:
        source: The source.

    Attributes:
        following: Whether the position is the newest instant of a run in progress.
        playing: Whether the position moves by itself.
        speed: Simulated seconds a wall second.
        backwards: Whether it moves towards the beginning.
    """

    def __init__(self, source: RunSource) -> None:
        self._source = source
        self.following = source.live
        self.playing = False
        self.speed = 1.0
        self.backwards = False
        self._time_s = 0.0

    @property
    def index(self) -> int:
        """Index of the last instant that is not after the position; -1 if there are no instants."""
        times = self._source.times_s
        if self.following or not len(times):
            return len(times) - 1
        return max(0, int(np.searchsorted(times, self._time_s, side="right")) - 1)

    def advance(self, wall_s: float) -> None:
        """Move the position by a wall time, s; stop at either end."""
        times = self._source.times_s
        if not self.playing or self.following or not len(times):
            return
        self._time_s += (-wall_s if self.backwards else wall_s) * self.speed
        if not times[0] <= self._time_s < times[-1]:
            self._time_s = float(np.clip(self._time_s, times[0], times[-1]))
            self.playing = False
            self.following = self._source.live and not self.backwards

    def toggle(self) -> None:
        """Play or pause; play from the other end if the position is at an end."""
        times = self._source.times_s
        self.playing = not self.playing
        if self.playing and not self.following and len(times):
            if not self.backwards and self.index == len(times) - 1:
                self.seek(0)
            elif self.backwards and self.index == 0:
                self.seek(len(times) - 1)

    def seek(self, index: int) -> None:
        """Move to an instant, the nearest that there is; the newest of a run in progress is followed."""
        times = self._source.times_s
        if len(times):
            last = len(times) - 1
            self.following = self._source.live and index >= last > 0
            self._time_s = float(times[min(max(index, 0), last)])

    def seek_time(self, time_s: float) -> None:
        """Move to the first instant that is not before a time, s."""
        self.seek(int(np.searchsorted(self._source.times_s, time_s - 1e-12)))

    def step(self, instants: int) -> None:
        """Pause and move by a number of instants."""
        index = self.index
        self.playing = False
        self.seek(index + instants)

    def follow(self) -> None:
        """Follow the run in progress, or move to the end of a recording."""
        if self._source.live:
            self.following, self.playing = True, False
        else:
            self.seek(len(self._source.times_s) - 1)
