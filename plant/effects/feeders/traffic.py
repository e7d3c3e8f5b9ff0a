"""Parcel traffic: feeding, queues at feeders, exits, and transit times."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.state import StateFields
from plant import geometry
from plant.effects.feeders.spec import FeedersSpec
from plant.observations import Event, ExitCount, FeedCount, ParcelStatus, TrafficCount, Transit
from plant.overlap import OverlapDetector
from plant.wheels import Floats


@final
@dataclass(slots=True)
class _Queue:
    """The parcels of one feeder: their numbers run from ``first`` on, in the order in which they are fed.

    Attributes:
        due_ns: When each is due.
        clear_m: How near no other's centre of mass may be.
        called_ns: When each was first due at an update, of those that were.
        fed: How many have been fed.
        held_back: How many found no room when they were due.
        longest_ns: The longest that one had to wait.
    """

    state_fields: ClassVar[StateFields] = StateFields("called_ns", "fed", "held_back", "longest_ns")

    name: str
    first: int
    due_ns: list[int]
    clear_m: float = 0.0
    called_ns: list[int] = field(default_factory=list[int])
    fed: int = 0
    held_back: int = 0
    longest_ns: int = 0

    @property
    def head(self) -> int:
        """Number of the parcel to be fed next."""
        return self.first + self.fed

    def dequeue(self, time_ns: int) -> int:
        """Note who is due by now; returns how many were before."""
        before = len(self.called_ns)
        while len(self.called_ns) < len(self.due_ns) and self.due_ns[len(self.called_ns)] <= time_ns:
            self.called_ns.append(time_ns)
        return before


@final
@dataclass(slots=True)
class _Gate:
    """Exit with its edges, the transit times of parcels that left, and the number of misrouted parcels."""

    state_fields: ClassVar[StateFields] = StateFields("transit_ns", "misrouted")

    name: str
    normal: Floats
    offset: Floats
    transit_ns: list[int] = field(default_factory=list[int])
    misrouted: int = 0

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Which of the points ``(k, 2)`` are in it, its boundary included."""
        x, y = points[:, :1], points[:, 1:]
        return np.all(x * self.normal[:, 0] + y * self.normal[:, 1] <= self.offset, axis=1)


@final
class Traffic:
    """Feeds parcels and removes parcels in exits, at the instants of its updates.

    A parcel is fed at the first update at or after its feed time at which it overlaps no other parcel, in the order of
    each feeder's queue. A parcel leaves at the first update at which its centre of mass lies in an exit. Within one
    update, leaving parcels make room for fed parcels; feeders and exits are processed in the order of the scene.

    Args:
        spec: feeders and exits.
        seed: seed of the scene.
        state: states of all parcels, ``(parcels, 6)``, the scene's own first and then the feeders'. The array is the
            solver's: waiting parcels have velocity 0 and get their velocity when they are fed.
        status: status of every parcel, kept up to date.
        overlaps: overlap detector of the parcels' footprints.
        destinations: exit that each parcel is meant for, if any.

    Attributes:
        on_surface: ascending indices of the parcels that neither wait nor have left.
    """

    state_fields: ClassVar[StateFields] = StateFields("_queues", "_gates", "_since_ns", "on_surface")

    def __init__(
        self,
        spec: FeedersSpec,
        seed: int,
        state: Floats,
        status: list[ParcelStatus],
        overlaps: OverlapDetector,
        destinations: Sequence[str | None],
    ) -> None:
        self._destinations = destinations
        self._state = state
        self._status = status
        self._overlaps = overlaps
        self._queues: list[_Queue] = []
        own = first = len(state) - spec.total
        for feed in spec.feed:
            self._queues.append(_Queue(feed.name, first, feed.due_ns(seed), feed.clear_m))
            first += feed.total
        self._gates = [_Gate(exit_.name, *geometry.edges(exit_.corners())) for exit_ in spec.exits]
        self._since_ns: dict[int, int] = dict.fromkeys(range(own), 0)
        self._velocity: Floats = state[:, 3:].copy()
        state[own:, 3:] = 0.0
        self.on_surface: NDArray[np.int64] = np.arange(own)
        for queue in self._queues:
            for place in range(len(queue.due_ns)):
                status[queue.first + place] = ParcelStatus("waiting", 0.0, f"for feeder {queue.name}")

    def exit_at(self, point: Floats) -> str | None:
        """Name of the exit that a point ``(2,)`` lies in."""
        return next((gate.name for gate in self._gates if gate.contains(point[None])[0]), None)

    def update(self, time_ns: int) -> list[Event]:
        """Let parcels leave and feed others, as they should by now.

        Returns:
            Events ``left``, ``held_back`` and ``fed``.
        """
        events = [event for gate in self._gates for event in self._let_out(gate, time_ns)]
        for queue in self._queues:
            called = queue.dequeue(time_ns)
            while queue.fed < len(queue.called_ns):
                other = self._overlaps.first_blocker(queue.head, self._state, self.on_surface, queue.clear_m)
                if other is not None:
                    events.extend(self._hold_back(queue, called, other))
                    break
                events.append(self._feed(queue, time_ns))
        return events

    def _let_out(self, gate: _Gate, time_ns: int) -> Iterator[Event]:
        for i in map(int, self.on_surface[gate.contains(self._state[self.on_surface, :2])]):
            if self._status[i].rides:
                self.on_surface = self.on_surface[self.on_surface != i]
                self._state[i, 3:] = 0.0
                self._status[i] = ParcelStatus("delivered", time_ns * 1e-9, f"through exit {gate.name}")
                transit_ns = time_ns - self._since_ns[i]
                gate.transit_ns.append(transit_ns)
                text = f"through exit {gate.name} after {transit_ns * 1e-9:.6g} s"
                meant = self._destinations[i]
                if meant not in (None, gate.name):
                    gate.misrouted += 1
                    text += f", though meant for {meant}"
                yield self._event(time_ns, "left", i, text)

    def _feed(self, queue: _Queue, time_ns: int) -> Event:
        """Feed the next of a queue."""
        i, held_ns = queue.head, time_ns - queue.called_ns[queue.fed]
        queue.longest_ns = max(queue.longest_ns, held_ns)
        queue.fed += 1
        self.on_surface = np.sort(np.append(self.on_surface, i))
        self._state[i, 3:] = self._velocity[i]
        self._status[i] = ParcelStatus("moving", time_ns * 1e-9)
        self._since_ns[i] = time_ns
        held = f", held back {held_ns * 1e-9:.6g} s" if held_ns else ""
        return self._event(time_ns, "fed", i, f"by feeder {queue.name}{held}")

    def _hold_back(self, queue: _Queue, called: int, other: int) -> Iterator[Event]:
        """Count and report newly due parcels of a queue, after the first ``called``, that parcel ``other`` blocks."""
        for place in range(max(called, queue.fed), len(queue.called_ns)):
            queue.held_back += 1
            i = queue.first + place
            why = f"parcel {other} is in the way" if i == queue.head else f"parcel {i - 1} is before it"
            yield self._event(queue.called_ns[place], "held_back", i, f"at feeder {queue.name}: {why}")

    def _event(self, time_ns: int, kind: str, i: int, detail: str) -> Event:
        x, y = self._state[i, :2].tolist()
        return Event(time_ns * 1e-9, kind, i, (), (x, y), detail)

    def count(self, time_ns: int) -> TrafficCount:
        """Return the traffic statistics up to ``time_ns``."""
        feeders = [_feed_count(queue, time_ns) for queue in self._queues]
        exits = [
            ExitCount(gate.name, len(gate.transit_ns), gate.misrouted, Transit.of(gate.transit_ns))
            for gate in self._gates
        ]
        everyone = [transit_ns for gate in self._gates for transit_ns in gate.transit_ns]
        return TrafficCount(
            feed=feeders,
            exits=exits,
            waiting=sum(feeder.waiting for feeder in feeders),
            there=len(self.on_surface),
            left=len(everyone),
            misrouted=sum(gate.misrouted for gate in self._gates),
            transit_s=Transit.of(everyone),
            left_per_s=len(everyone) / (time_ns * 1e-9) if time_ns else None,
        )


def _feed_count(queue: _Queue, time_ns: int) -> FeedCount:
    held_ns = time_ns - queue.called_ns[queue.fed] if queue.fed < len(queue.called_ns) else 0
    return FeedCount(
        name=queue.name,
        fed=queue.fed,
        waiting=len(queue.due_ns) - queue.fed,
        held_back=queue.held_back,
        longest_hold_s=max(queue.longest_ns, held_ns) * 1e-9,
    )
