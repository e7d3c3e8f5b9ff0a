"""Errors of a trace against a reference: displacement of corners, events, and distributions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, final

import numpy as np
from numpy.typing import NDArray

from plant.geometry import corner_displacement_m

if TYPE_CHECKING:
    from plant.observations import Event

Floats = NDArray[np.float64]
Key = tuple[int, str, tuple[tuple[int, int], ...]]
"""Parcel, kind and cells of an event."""

COMPARED = frozenset(
    ("support_gained", "support_lost", "load_vanished", "load_returned", "tipped", "off_array")
)
"""Kinds of events that a motion has whoever solves it; captures, meetings and remarks are not among them."""
WINDOW_S = 0.05
"""Two events of one kind and cell are the same one if no farther apart than this."""
TOGETHER_S = 1e-9
"""Events no farther apart than this have no order."""
_OPPOSITE = {
    "support_gained": "support_lost",
    "support_lost": "support_gained",
    "load_vanished": "load_returned",
    "load_returned": "load_vanished",
}


def displacement_m(states: Floats, others: Floats, footprints_m: Sequence[Floats]) -> Floats:
    """Largest displacement of any corner of any parcel at each instant, ``(T,)``.

    Args:
        states: ``(T, m, 6)``.
        others: ``(T, m, 6)`` at the same instants.
        footprints_m: ``(v, 2)`` corners of each parcel about its centre of mass, in its axes.
    """
    largest: Floats = np.zeros(len(states))
    for i, corners in enumerate(footprints_m):
        largest = np.maximum(largest, corner_displacement_m(states[:, i], others[:, i], corners))
    return largest


@final
@dataclass(frozen=True, slots=True)
class EventErrors:
    """Agreement of a trace's events with a reference.

    Attributes:
        found: events of the reference that the trace has.
        missed: those that it has not.
        invented: its own that the reference has not.
        time_error_s: largest error in time of those found; None where there are none.
        order_until_s: until when both have the same events in the same order; None: to the end. What is invented and
            taken back at the same instant changes no order.
    """

    found: int
    missed: int
    invented: int
    time_error_s: float | None
    order_until_s: float | None


def compare_events(events: Sequence[Event], reference: Sequence[Event], until_s: float) -> EventErrors:
    """Match events with a reference's, up to ``until_s``.

    Each event is matched with the nearest of the same kind, parcel and cells, at most `WINDOW_S` away; the nearest
    pairs first, and each once.
    """
    mine, known = _by_key(events, until_s), _by_key(reference, until_s)
    pairs: list[tuple[float, float]] = []
    missed: list[float] = []
    invented: dict[Key, list[float]] = {}
    for key in sorted(mine.keys() | known.keys()):
        found, only_known, invented[key] = _matched(known.get(key, ()), mine.get(key, ()))
        pairs += found
        missed += only_known
    worst = max((abs(here - there) for there, here in pairs), default=None)
    apart = [*missed, *_lasting(invented), *_out_of_order(pairs)]
    count = sum(map(len, invented.values()))
    return EventErrors(len(pairs), len(missed), count, worst, min(apart) if apart else None)


def _by_key(events: Sequence[Event], until_s: float) -> Mapping[Key, list[float]]:
    """Times of the events compared: without loads that vanish or return because supports change at that instant."""
    times: dict[Key, list[float]] = {}
    supports = {(event.parcel, event.time_s) for event in events if event.kind.startswith("support_")}
    for event in events:
        jumps = event.kind.startswith("load_") and (event.parcel, event.time_s) in supports
        if event.kind in COMPARED and event.time_s <= until_s and not jumps:
            times.setdefault((event.parcel, event.kind, event.cells), []).append(event.time_s)
    return times


def _matched(
    known: Sequence[float], mine: Sequence[float]
) -> tuple[list[tuple[float, float]], list[float], list[float]]:
    """Pairs (reference's time, own time), and the times left over on either side."""
    near = sorted(
        (abs(here - there), i, j)
        for i, there in enumerate(known)
        for j, here in enumerate(mine)
        if abs(here - there) <= WINDOW_S
    )
    pairs: list[tuple[float, float]] = []
    left, right = set(range(len(known))), set(range(len(mine)))
    for _, i, j in near:
        if i in left and j in right:
            left.remove(i)
            right.remove(j)
            pairs.append((known[i], mine[j]))
    return pairs, [known[i] for i in sorted(left)], [mine[j] for j in sorted(right)]


def _lasting(invented: Mapping[Key, Sequence[float]]) -> list[float]:
    """Times of invented events that are not taken back on the spot."""
    return [
        at_s
        for (parcel, kind, cells), times in invented.items()
        for at_s in times
        if not any(
            abs(other - at_s) <= TOGETHER_S
            for other in invented.get((parcel, _OPPOSITE.get(kind, ""), cells), ())
        )
    ]


def _out_of_order(pairs: Sequence[tuple[float, float]]) -> list[float]:
    """Return the solver's times of events that precede an event which the reference has earlier."""
    latest, early = -np.inf, list[float]()
    rising = sorted(pairs)
    for number, (there, here) in enumerate(rising):
        if here < latest - TOGETHER_S and there - rising[number - 1][0] > TOGETHER_S:
            early.append(here)
        latest = max(latest, here)
    return early


def distribution_distance(values: Floats, others: Floats) -> float:
    """Kolmogorov and Smirnov's: the largest difference of the two distribution functions, 0 to 1."""
    both = np.sort(np.concatenate([values, others]))
    return float(
        np.max(
            np.abs(
                np.searchsorted(np.sort(values), both, side="right") / len(values)
                - np.searchsorted(np.sort(others), both, side="right") / len(others)
            )
        )
    )


def corner_speeds(states: Floats, footprints_m: Sequence[Floats]) -> Floats:
    """Bound on the speed of the fastest corner of every parcel at every instant, ``(T m,)`` m/s."""
    radius = np.array([np.hypot(*corners.T).max() for corners in footprints_m])
    return np.ravel(np.hypot(states[..., 3], states[..., 4]) + np.abs(states[..., 5]) * radius)
