"""Recording of a trajectory that was simulated without cells."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, final

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from deploy.recordings.writer import Recorder

Floats = NDArray[np.float64]


@final
class TrajectoryRecorder:
    """Records samples of a trajectory as the instants of a run.

    A row of a recording has the drives that act from its instant on, so the last row waits until the drives of the next
    part are known, or until the end.

    Args:
        recorder: Recorder whose header has no presence sensors.
        cells: Number of cells.
    """

    def __init__(self, recorder: Recorder, cells: int) -> None:
        self._recorder = recorder
        self._presence = np.zeros((cells, 0), dtype=np.bool_)
        self._drives: Floats = np.zeros((cells, 2))
        self._tick = 0
        self._waiting: tuple[int, Floats, Floats] | None = None

    def drive(self, drives: Floats) -> None:
        """Take the drives that act from the last row on, ``(n, 2)``, m/s."""
        self._drives = drives

    def rows(self, time_ns: NDArray[np.int64], states: Floats, wheel_speed: Floats) -> None:
        """Record samples.

        Args:
            time_ns: Instants, ``(k,)``, ns.
            states: States of the parcels, ``(k, m, 6)``.
            wheel_speed: Surface speeds of the wheels from the row before to the last of these, ``(n, 2)``, m/s.
        """
        for time, state in zip(time_ns.tolist(), states, strict=True):
            self._write(end=False)
            self._waiting = time, state, wheel_speed

    def event(self, event: Mapping[str, Any]) -> None:
        """Record an event of the plant."""
        self._recorder.event(event)

    def fault(self, fault: Mapping[str, Any]) -> None:
        """Record a fault."""
        self._recorder.fault(fault)

    def close(self, status: str, digest: str, motion_digest: str) -> None:
        """Record the last row as the end of the run, and finish the file."""
        self._write(end=True)
        self._recorder.close(status, digest, motion_digest)

    def _write(self, *, end: bool) -> None:
        if self._waiting is None:
            return
        time_ns, state, wheel_speed = self._waiting
        self._recorder.tick(
            self._tick, time_ns, self._presence, None if end else self._drives, wheel_speed, state
        )
        self._tick += 1
        self._waiting = None
