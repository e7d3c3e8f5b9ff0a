"""Parcels that come to rest, and those that leave it."""

from __future__ import annotations

from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.memory import Remembers
from plant.reports import Floats, ParcelState, ParcelStatus

Numbers = NDArray[np.int64]


@final
class RestWatch:
    """Tells which parcels rest, from their states at instants.

    Args:
        radius: ``(m,)`` farthest corner of each parcel from its centre of mass, m.
        slow_m_s: a parcel none of whose corners moves faster, or gains speed faster than this a second, is at rest.
    """

    remembers: ClassVar[Remembers] = Remembers("_resting")

    def __init__(self, radius: Floats, slow_m_s: float) -> None:
        from plant.kernels import entry  # compiles or loads: only where a plant is really built

        self._entry: Any = entry
        self._radius, self._slow_m_s = radius, slow_m_s
        self._resting: NDArray[np.bool_] = np.zeros(len(radius), dtype=np.bool_)

    def may_change(self, state: Floats, which: Numbers) -> bool:
        """Whether some parcel is slow, or at rest so far: else `changes` has none, and its work can be spared.

        Args:
            state: ``(m, 6)``, now.
            which: Parcels that are watched.
        """
        return self._entry.any_slow(state, self._radius, self._resting, which, self._slow_m_s)

    def changes(
        self, states: Floats, times_ns: NDArray[np.int64], which: Numbers
    ) -> list[tuple[int, ParcelStatus]]:
        """Parcels that have come to rest or begun to move, and how they fare since when.

        Args:
            states: ``(T, m, 6)``.
            times_ns: ``(T,)`` instants of the states.
            which: Parcels that are watched.
        """
        if len(times_ns) < 2:
            return []
        scale = np.ones((len(which), 3))
        scale[:, 2] = self._radius[which]
        speed = states[:, which, 3:] * scale
        slow = np.max(np.abs(speed), axis=2) < self._slow_m_s
        span_s = np.diff(times_ns)[:, None] * 1e-9
        steady = np.max(np.abs(np.diff(speed, axis=0)), axis=2) < self._slow_m_s * span_s
        still = slow[1:] & slow[:-1] & steady
        at_end = still[-1]
        differs = still != at_end
        news: list[tuple[int, ParcelStatus]] = []
        for k in np.flatnonzero((at_end != self._resting[which]) | np.any(differs, axis=0)).tolist():
            changed = np.flatnonzero(differs[:, k])
            since = changed[-1] + 1 if len(changed) else 0
            state: ParcelState = "at_rest" if at_end[k] else "moving"
            news.append((int(which[k]), ParcelStatus(state, float(times_ns[since + at_end[k]]) * 1e-9)))
        self._resting[which] = at_end
        return news
