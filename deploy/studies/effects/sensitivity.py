"""Sensitivity: difference between two runs of similar scenes in paths, settling times and events."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, final

import numpy as np

from plant.geometry import corner_displacement_m

if TYPE_CHECKING:
    from deploy.runs.result import RunResult
    from deploy.studies.effects.run import TracedRun
    from plant.observations import Event
    from plant.wheels import Floats

_ROUNDING_S = 1e-12
"""Bounds on the shift of events are told apart down to this."""


class EventShift(NamedTuple):
    """One event in two runs.

    Attributes:
        kind: Kind of the event.
        parcel: Index of the parcel.
        cells: ``(row, column)`` of the cells concerned.
        times_s: Time in either run, s.
    """

    kind: str
    parcel: int
    cells: tuple[tuple[int, int], ...]
    times_s: tuple[float, float]

    @property
    def shift_s(self) -> float:
        """Distance in time, s."""
        return abs(self.times_s[0] - self.times_s[1])


@final
@dataclass(frozen=True, slots=True, kw_only=True)
class Sensitivity:
    """Difference between two runs.

    Attributes:
        displacement_m: Largest displacement of a footprint's corner at any tick of the run, m. None where no parcel is
            there in both runs at the same time.
        at_s: Time of the largest displacement, s.
        parcel: Index of the parcel that has it.
        turn_rad: Largest difference of a parcel's angles at any tick, in [0, pi].
        end_m: Largest displacement of a corner at the end, m. None where no parcel is there in both runs.
        end_rad: Largest difference of a parcel's angles at the end.
        parcels: Number of parcels that are there at the end of one run only.
        settled_s: Time from which all parcels rest, in either run, s. None where a parcel doesn't rest.
        events: Number of events that both runs have, matched by kind, parcel and cells.
        moved: The matched event with the largest shift in time. None without a matched event.
        only: Number of events that only the one run has, and only the other.
    """

    displacement_m: float | None
    at_s: float | None = None
    parcel: int | None = None
    turn_rad: float | None
    end_m: float | None
    end_rad: float | None
    parcels: int
    settled_s: tuple[float | None, float | None]
    events: int
    moved: EventShift | None
    only: tuple[int, int]

    @property
    def moved_s(self) -> float | None:
        """Largest shift of a matched event in time, s."""
        return None if self.moved is None else self.moved.shift_s

    @property
    def settling_s(self) -> float | None:
        """Difference of settling times, s; None unless both runs settle."""
        one, other = self.settled_s
        return None if one is None or other is None else one - other

    @property
    def none(self) -> bool:
        """Whether the runs are the same, to the last bit of all that is compared."""
        return not (self.displacement_m or self.turn_rad or self.parcels or self.moved_s or any(self.only))


def compare(one: TracedRun, other: TracedRun) -> Sensitivity:
    """Compute the difference between two runs at the ticks that both have; parcels are matched by number."""
    _, mine, theirs = np.intersect1d(one.time_ns, other.time_ns, assume_unique=True, return_indices=True)
    count = min(one.path.shape[1], other.path.shape[1])  # parcels that a feeder may feed are in one run only
    largest = _Largest(
        one.time_ns[mine].astype(np.float64) * 1e-9,
        one.path[mine],
        other.path[theirs],
        one.result.footprints_m[:count],
    )
    there, there_too = _there(one.result), _there(other.result)
    both = sorted(there & there_too)
    ends = one.result.state[None, both], other.result.state[None, both]
    final = _Largest(np.zeros(1), *ends, [one.result.footprints_m[number] for number in both])
    moved, only = _shifts(one.result.events, other.result.events)
    return Sensitivity(
        displacement_m=largest.displacement_m,
        at_s=largest.at_s,
        parcel=largest.parcel,
        turn_rad=largest.turn_rad,
        end_m=final.displacement_m,
        end_rad=final.turn_rad,
        parcels=len(there ^ there_too),
        settled_s=(_settled_s(one.result), _settled_s(other.result)),
        events=len(moved),
        moved=max(moved, key=lambda shift: shift.shift_s, default=None),
        only=only,
    )


@final
class _Largest:
    """Largest displacement and rotation between two paths, and when and which parcel.

    Args:
        time_s: ``(T,)`` instants, s.
        path: ``(T, m, 6)``; NaN where a parcel is not there.
        others: Likewise, of the other run.
        footprints_m: ``(v, 2)`` corners of each parcel about its centre of mass, in its axes, m.
    """

    def __init__(self, time_s: Floats, path: Floats, others: Floats, footprints_m: Sequence[Floats]) -> None:
        self.displacement_m: float | None = None
        self.at_s: float | None = None
        self.parcel: int | None = None
        self.turn_rad: float | None = None
        for number, footprint in enumerate(footprints_m):
            apart = corner_displacement_m(path[:, number], others[:, number], footprint)
            if np.isnan(apart).all():
                continue
            tick = int(np.nanargmax(apart))
            if self.displacement_m is None or apart[tick] > self.displacement_m:
                self.displacement_m = float(apart[tick])
                self.at_s, self.parcel = float(time_s[tick]), number
            turns = path[:, number, 2] - others[:, number, 2]
            turns -= math.tau * np.round(turns / math.tau)
            self.turn_rad = max(self.turn_rad or 0.0, float(np.nanmax(np.abs(turns))))


def _there(result: RunResult) -> set[int]:
    """Return the indices of parcels on the array, tipped parcels included."""
    return {n for n, fate in enumerate(result.parcel_status) if fate.state not in ("waiting", "delivered")}


def _settled_s(result: RunResult) -> float | None:
    """Since when every parcel that is there rests, or lies tipped; None where one moves, or none is there."""
    fates = [result.parcel_status[number] for number in _there(result)]
    if not fates or any(fate.state == "moving" for fate in fates):
        return None
    return max(fate.time_s for fate in fates)


def _shifts(events: Sequence[Event], others: Sequence[Event]) -> tuple[list[EventShift], tuple[int, int]]:
    """Match the events of two runs; return the pairs, and how many events only either run has."""
    mine, theirs = _times_s(events), _times_s(others)
    moved = [
        EventShift(*key, times_s)
        for key in mine.keys() & theirs.keys()
        for times_s in match(mine[key], theirs[key])
    ]
    return moved, (len(events) - len(moved), len(others) - len(moved))


def match(times_s: Sequence[float], others_s: Sequence[float]) -> list[tuple[float, float]]:
    """Match equal events of two runs in their order, all of the run that has fewer.

    Of all such matches the returned one has the least largest shift in time, to 1e-12 s. So an additional event at the
    start of one run doesn't shift all that follow.

    Args:
        times_s: Times of the one run, s, rising.
        others_s: Times of the other run, s, rising.

    Returns:
        Pairs of a time of the one run and a time of the other, s.
    """
    if len(times_s) > len(others_s):
        return [(one, other) for other, one in match(others_s, times_s)]
    in_order = list(zip(times_s, others_s, strict=False))
    if len(times_s) == len(others_s):
        return in_order
    low, high, best = 0.0, max((abs(one - other) for one, other in in_order), default=0.0), in_order
    while high - low > _ROUNDING_S:
        bound = 0.5 * (low + high)
        found = _within(times_s, others_s, bound)
        if found is None:
            low = bound
        else:
            best, high = found, max(abs(one - other) for one, other in found)
    return best


def _within(
    times_s: Sequence[float], others_s: Sequence[float], bound_s: float
) -> list[tuple[float, float]] | None:
    """Match each time with the earliest one left in the other run within a bound; None where one has no match."""
    pairs: list[tuple[float, float]] = []
    left = iter(others_s)
    for one in times_s:
        other = next((time_s for time_s in left if time_s >= one - bound_s), None)
        if other is None or other > one + bound_s:
            return None
        pairs.append((one, other))
    return pairs


def _times_s(events: Sequence[Event]) -> dict[tuple[str, int, tuple[tuple[int, int], ...]], list[float]]:
    """Group event times by kind, parcel and cells, s, in order."""
    found: dict[tuple[str, int, tuple[tuple[int, int], ...]], list[float]] = defaultdict(list)
    for event in events:
        found[event.kind, event.parcel, event.cells].append(event.time_s)
    return found
