"""Quantities of the wheels under parcels: load, slip and traction, computed in the page's process."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final, final

import numpy as np

from deploy.view.quantities import Quantity, Values

if TYPE_CHECKING:
    from deploy.recordings.quantities import RecordedTractions
    from deploy.view.source import Floats, Instant, RunSource
    from plant.analysis.tractions import ArrayTractions


_REST: Final = 3.0
"""Least rest after a computation, by the time that it took: many parcels don't slow the page down."""


_STANDS_S: Final = 0.2
"""Wall time after which an instant that is still looked at has its own values, whatever they take."""


@final
class WheelForces:
    """Loads, slips and tractions of a run, computed when they are looked at, by default at most a quarter of the time.

    Args:
        source: The run.
        rest: Least rest after a computation, by the time that it took; 0: every instant is computed.

    Attributes:
        quantities: Load, slip and traction, for `deploy.view.colouring.Colouring`.
    """

    def __init__(self, source: RunSource, rest: float = _REST) -> None:
        self._source, self._rest = source, rest
        self._tractions: RecordedTractions | None = None
        self._unknown = False
        self._last: tuple[Instant, ArrayTractions] | None = None
        self._next_s = 0.0
        self._looked_at = (np.nan, 0.0)
        self.quantities = (
            Quantity("load", "load", "N", lambda _, __, instant: Values(self.loads_n(instant))),
            Quantity("slip", "slip", "m/s", lambda _, __, instant: Values(self._slips_m_s(instant))),
            Quantity("traction", "traction", "N", lambda _, __, instant: Values(self._tractions_n(instant))),
        )

    def loads_n(self, instant: Instant) -> Floats:
        """Return the normal force on every cell, ``(n,)``, N; NaN where it is unknown."""
        found = self._at(instant)
        return np.full(len(instant.health), np.nan) if found is None else found.load_n

    def _slips_m_s(self, instant: Instant) -> Floats:
        """Return the amount of slip of every cell's wheels, ``(n,)``; NaN without load."""
        found = self._at(instant)
        return np.full(len(instant.health), np.nan) if found is None else np.hypot(*found.slip_m_s.T)

    def _tractions_n(self, instant: Instant) -> Floats:
        """Return the amount of traction of every cell's wheels, ``(n,)``; NaN at wheels that stick."""
        found = self._at(instant)
        return np.full(len(instant.health), np.nan) if found is None else np.hypot(*found.traction_n.T)

    def _at(self, instant: Instant) -> ArrayTractions | None:
        """Return the values of an instant; None if the header's scene is not one of this version."""
        begun = time.perf_counter()
        if instant.time_s != self._looked_at[0]:
            self._looked_at = instant.time_s, begun
        stands = begun - self._looked_at[1] > _STANDS_S
        if self._last is not None:
            resting = begun < self._next_s and not stands
            if resting or _alike(self._last[0], instant):
                return self._last[1]
        if self._tractions is None and not self._unknown:
            from deploy.recordings.quantities import RecordedTractions

            source = self._source
            try:
                self._tractions = RecordedTractions(source.header, source.events, source.faults)
            except ValueError:
                self._unknown = True
        if self._tractions is None:
            return None
        found = self._tractions.at(instant.time_s, instant.parcels, instant.wheel_speeds.astype(np.float64))
        self._last = instant, found
        ended = time.perf_counter()
        self._next_s = ended + self._rest * (ended - begun)
        return found


def _alike(one: Instant, other: Instant) -> bool:
    """Whether two instants have the same values."""
    return one is other or (
        one.time_s == other.time_s
        and np.array_equal(one.parcels, other.parcels, equal_nan=True)
        and np.array_equal(one.wheel_speeds, other.wheel_speeds, equal_nan=True)
    )
