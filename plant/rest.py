"""Parcels that come to rest, and those that leave it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import final

import numpy as np
from numpy.typing import NDArray

from plant.reports import Floats, ParcelState, ParcelStatus

REST_SPEED_M_S = 1e-6
"""A parcel none of whose corners moves faster, or gains speed faster than this per second, is at rest."""


@final
class RestWatch:
    """Tells which parcels rest, from their states at instants.

    Args:
        radius: ``(m,)`` farthest corner of each parcel from its centre of mass, m.
    """

    def __init__(self, radius: Floats) -> None:
        self._radius = radius

    def may_change(self, state: Floats, status: Sequence[ParcelStatus]) -> bool:
        """Whether some parcel is slow, or at rest so far: else `changes` has none, and its work can be spared.

        Args:
            state: ``(m, 6)``, now.
            status: Of each parcel, so far.
        """
        for (_, _, _, vx, vy, omega), radius, so_far in zip(
            state.tolist(), self._radius.tolist(), status, strict=True
        ):
            if so_far.state == "at_rest" or max(abs(vx), abs(vy), abs(omega) * radius) < REST_SPEED_M_S:
                return True
        return False

    def changes(
        self, states: Floats, times_ns: NDArray[np.int64], status: Sequence[ParcelStatus]
    ) -> Iterator[tuple[int, ParcelStatus]]:
        """Parcels that have come to rest or begun to move, and how they fare since when.

        Args:
            states: ``(T, m, 6)``.
            times_ns: ``(T,)`` instants of the states.
            status: Of each parcel, so far.
        """
        if len(times_ns) < 2 or not status:
            return
        scale = np.ones((len(status), 3))
        scale[:, 2] = self._radius
        speed = states[:, :, 3:] * scale
        slow = np.max(np.abs(speed), axis=2) < REST_SPEED_M_S
        span_s = np.diff(times_ns)[:, None] * 1e-9
        steady = np.max(np.abs(np.diff(speed, axis=0)), axis=2) < REST_SPEED_M_S * span_s
        still = slow[1:] & slow[:-1] & steady
        for i, so_far in enumerate(status):
            if so_far.state in ("tipped", "off_array"):
                continue
            at_end = bool(still[-1, i])
            changed = np.flatnonzero(still[:, i] != at_end)
            state: ParcelState = "at_rest" if at_end else "moving"
            if state != so_far.state or len(changed):
                since = changed[-1] + 1 if len(changed) else 0
                yield i, ParcelStatus(state, float(times_ns[since + at_end]) * 1e-9)
