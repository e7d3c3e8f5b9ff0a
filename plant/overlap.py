"""Detection of overlapping parcels: reported, not resolved."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import ClassVar, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant import geometry
from plant.geometry import Pairs, close_boxes, close_pairs
from plant.observations import Event

Floats = NDArray[np.float64]
Indices = NDArray[np.int64]
Place = tuple[float, float]


def meeting(time_s: float, kind: str, first: int, second: int, depth_m: float, place: Place) -> Event:
    """A change of an `OverlapDetector` as the plant reports it."""
    deep = f", {depth_m:.3g} m deep" if depth_m else ""
    return Event(time_s, kind, first, (), place, f"with parcel {second}{deep}")


_REACH: Final = 0.5
"""How much larger circles are taken in the search for neighbours, as a share of the mean one's radius."""


@final
class NeighbourList:
    """Pairs of parcels whose circles may touch, searched for again once a parcel has moved far enough to matter.

    Args:
        radius: distance of each parcel's farthest corner, ``(m,)``, m.
    """

    def __init__(self, radius: Floats) -> None:
        self._radius = radius
        self._reach = _REACH * float(np.mean(radius)) if len(radius) else 0.0
        # two parcels come nearer to each other by what both move; a hair less for rounding
        self._far_2 = (0.999 * self._reach) ** 2
        self._there: Indices | None = None
        self._centre: Floats = np.zeros((0, 2))
        self._pairs: Pairs = np.zeros((0, 2), dtype=np.intp)

    def touching(self, state: Floats, there: Indices) -> Pairs:
        """Return pairs of positions in ``there`` whose circles overlap, as ``geometry.close_pairs`` does."""
        centre = state[there, :2]
        if there is not self._there or self._moved_far(centre):
            self._there, self._centre = there, centre
            self._pairs = close_pairs(centre, self._radius[there] + self._reach)
        near = self._pairs
        if not len(near):
            return near
        i, j = near.T
        gap, reach = centre[i] - centre[j], self._radius[there[i]] + self._radius[there[j]]
        return near[np.hypot(gap[:, 0], gap[:, 1]) < reach]

    def _moved_far(self, centre: Floats) -> bool:
        moved = centre - self._centre
        moved *= moved
        # not-a-number is far, too
        return not (moved[:, 0] + moved[:, 1]).max(initial=0.0) < self._far_2


@final
class OverlapDetector:
    """Detects overlaps of all pairs of parcels at sampled instants.

    Args:
        footprints: corners of each parcel about its centre of mass, counter-clockwise, ``(v, 2)``, m.
        radius: distance of each parcel's farthest corner, ``(m,)``, m.
    """

    state_fields: ClassVar[StateFields] = StateFields("_met")

    def __init__(self, footprints: Sequence[Floats], radius: Floats) -> None:
        self._footprints = footprints
        self._radius = radius
        self._neighbours = NeighbourList(radius)
        self._met: set[tuple[int, int]] = set()

    def _placed(self, i: int, pose: Floats) -> Floats:
        return geometry.placed(self._footprints[i], pose)

    def pairs(self, state: Floats, there: Indices) -> Iterator[tuple[int, int, float, Place]]:
        """Pairs that overlap now: both indices, depth in m, place in m.

        Args:
            state: ``(parcels, 6)``.
            there: ascending indices of the parcels that are there.
        """
        for pair in self._neighbours.touching(state, there):
            i, j = there[pair].tolist()
            found = geometry.overlap(self._placed(i, state[i]), self._placed(j, state[j]))
            if found is not None:
                yield i, j, found[0], (float(found[1][0]), float(found[1][1]))

    def first_blocker(self, i: int, state: Floats, there: Indices, clear_m: float = 0.0) -> int | None:
        """Find the first present parcel that parcel ``i`` would overlap at its pose.

        Parcels whose centre of mass is nearer to that of ``i`` than ``clear_m`` count as blockers, too.
        """
        gap = state[there, :2] - state[i, :2]
        apart = np.hypot(gap[:, 0], gap[:, 1])
        close = there[apart < clear_m]
        if len(close):
            return int(close[0])
        near = apart < self._radius[there] + self._radius[i]
        placed = self._placed(i, state[i])
        for j in there[near].tolist():
            if geometry.overlap(placed, self._placed(j, state[j])) is not None:
                return j
        return None

    def changes(self, state: Floats, there: Indices) -> list[tuple[str, int, int, float, Place]]:
        """Return changes since the last call: ``overlap`` or ``apart``, the pair, depth and place; see `pairs`."""
        if len(self._radius) < 2:
            return []
        now = {(i, j): (depth, place) for i, j, depth, place in self.pairs(state, there)}
        changes = [("overlap", i, j, *now[i, j]) for i, j in now if (i, j) not in self._met]
        changes += [
            ("apart", i, j, 0.0, (float(state[i, 0]), float(state[i, 1])))
            for i, j in sorted(self._met)
            if (i, j) not in now
        ]
        self._met = set(now)
        return changes

    def candidate_instants(self, states: Floats) -> Iterator[int]:
        """Instants among the states ``(T, parcels, 6)`` at which some pair's circles touch, or one has met before."""
        if len(self._radius) < 2:
            return
        reach = self._radius[:, None]
        centre = states[:, :, :2]
        near = np.zeros(len(states), dtype=np.bool_)
        # only pairs whose ways come near each other are followed through all instants
        for i, j in close_boxes(centre.min(axis=0) - reach, centre.max(axis=0) + reach).tolist():
            gap = centre[:, i] - centre[:, j]
            near |= np.hypot(gap[:, 0], gap[:, 1]) < self._radius[i] + self._radius[j]
        for k in np.flatnonzero(near | np.roll(near, 1)):
            yield int(k)
