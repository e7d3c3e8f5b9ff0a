"""Sensitivity: difference between two runs of similar scenes in poses, settling times and events."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np

from plant import geometry

if TYPE_CHECKING:
    from deploy.runs.result import RunResult
    from plant.observations import Event
    from plant.wheels import Floats


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """Difference between two runs.

    Attributes:
        displacement_m: The farthest that a corner of a footprint is, at the end, from where it is in the other run;
            None where no parcel is there in both.
        turn_rad: The farthest that a parcel is turned from how it lies in the other run, in [0, pi].
        parcels: How many are there at the end of one run only.
        settled_s: When all parcels rest, in the one and in the other; None where some don't.
        events: Events that both have, matched by kind, parcel and cells, in their order.
        moved_s: The farthest that one of them is moved in time; None where there is none.
        only: Events that only the one has, and only the other.
    """

    displacement_m: float | None
    turn_rad: float | None
    parcels: int
    settled_s: tuple[float | None, float | None]
    events: int
    moved_s: float | None
    only: tuple[int, int]

    @property
    def settling_s(self) -> float | None:
        """Difference of settling times, s; None unless both runs settle."""
        one, other = self.settled_s
        return None if one is None or other is None else one - other

    @property
    def none(self) -> bool:
        """Whether the runs are the same, to the last bit of all that is compared."""
        return not (self.displacement_m or self.turn_rad or self.parcels or self.moved_s or any(self.only))


def compare(one: RunResult, other: RunResult) -> Sensitivity:
    """Compute the difference between two runs; parcels are matched by number."""
    there, there_too = _there(one), _there(other)
    both = sorted(there & there_too)
    shifts = [_displacement(one, other, number) for number in both]
    turns = [abs(math.remainder(one.state[n, 2] - other.state[n, 2], math.tau)) for n in both]
    moved, only = _shifts(one.events, other.events)
    return Sensitivity(
        displacement_m=max(shifts, default=None),
        turn_rad=max(turns, default=None),
        parcels=len(there ^ there_too),
        settled_s=(_settled_s(one), _settled_s(other)),
        events=len(moved),
        moved_s=max(moved, default=None),
        only=only,
    )


def _there(result: RunResult) -> set[int]:
    """Return the indices of parcels on the array, tipped parcels included."""
    return {n for n, fate in enumerate(result.parcel_status) if fate.state not in ("waiting", "delivered")}


def _displacement(one: RunResult, other: RunResult, number: int) -> float:
    """Of the farthest corner of a parcel, m."""
    corners = [_corners(result, number) for result in (one, other)]
    return float(np.max(np.hypot(*(corners[0] - corners[1]).T)))


def _corners(result: RunResult, number: int) -> Floats:
    """``(v, 2)`` in world coordinates."""
    return geometry.placed(result.footprints_m[number], result.state[number, :3])


def _settled_s(result: RunResult) -> float | None:
    """Since when every parcel that is there rests, or lies tipped; None where one moves, or none is there."""
    fates = [result.parcel_status[number] for number in _there(result)]
    if not fates or any(fate.state == "moving" for fate in fates):
        return None
    return max(fate.time_s for fate in fates)


def _shifts(events: Sequence[Event], others: Sequence[Event]) -> tuple[list[float], tuple[int, int]]:
    """How far each event that both have is moved in time, and how many only one has."""
    mine, theirs = _times_s(events), _times_s(others)
    moved = [
        abs(one - other)
        for key in mine.keys() & theirs.keys()
        for one, other in zip(mine[key], theirs[key], strict=False)
    ]
    return moved, (len(events) - len(moved), len(others) - len(moved))


def _times_s(events: Sequence[Event]) -> dict[tuple[object, ...], list[float]]:
    """Group event times by kind, parcel and cells, s, in order."""
    found: dict[tuple[object, ...], list[float]] = defaultdict(list)
    for event in events:
        found[event.kind, event.parcel, event.cells].append(event.time_s)
    return found
