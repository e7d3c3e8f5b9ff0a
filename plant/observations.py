"""Outputs of the plant: sensor readings, events, parcel states, trajectories and traffic statistics."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
ParcelState = Literal["waiting", "moving", "at_rest", "tipped", "off_array", "delivered"]


@final
@dataclass(frozen=True, slots=True)
class Sense:
    """Sensor readings of all cells at an instant.

    Attributes:
        presence: ``(n, sensors)`` bool.
        encoder_m: ``(n, 2)`` surface passed since the start, m, read-only; None where there are no encoders.
        level: ``(n, sensors)`` share of each sensor's spot that is covered, 0 to 1; None without ``analogue_sensors``.
        label: ``(n,)`` number of the exit that the parcel over a cell's scanner is meant for, 0 for none; None without
            ``scanners``.
    """

    presence: NDArray[np.bool_]
    encoder_m: Floats | None
    level: Floats | None = None
    label: NDArray[np.int64] | None = None

    def with_cells(self, cells: NDArray[np.int64], now: Sense) -> Sense:
        """Return a copy with the readings of ``cells`` taken from ``now``, except encoders."""
        level = None if self.level is None or now.level is None else self.level.copy()
        label = None if self.label is None or now.label is None else self.label.copy()
        presence = self.presence.copy()
        presence[cells] = now.presence[cells]
        if level is not None and now.level is not None:
            level[cells] = now.level[cells]
        if label is not None and now.label is not None:
            label[cells] = now.label[cells]
        return Sense(presence, self.encoder_m, level, label)


class Event(NamedTuple):
    """Something that happened in the plant.

    Attributes:
        time_s: when.
        kind: ``support_gained``, ``support_lost``, ``load_vanished``, ``load_returned``, ``captured``, ``released``,
            ``outrun`` (a parcel outruns a wheel though its law says that none does), ``tipped``, ``off_array``,
            ``overlap``, ``contact``, ``apart``, ``contact_residual`` (contact problems were not solved in full),
            ``parted`` (overlapping parcels were moved apart), ``fed``, ``held_back`` (a parcel is due where there is no
            room) or ``left``.
        parcel: index of the parcel.
        cells: ``(row, column)`` of the cells concerned.
        position_m: where.
        detail: in words, where there is more to say.
    """

    time_s: float
    kind: str
    parcel: int
    cells: tuple[tuple[int, int], ...]
    position_m: tuple[float, float]
    detail: str = ""


@final
@dataclass(frozen=True, slots=True)
class ParcelStatus:
    """Status of a parcel.

    Attributes:
        state: ``waiting`` off the surface to be fed; ``moving``; ``at_rest``; ``tipped``, and it stays where it tipped
            and carries no wheel; ``off_array``, tipped across the outer edge; ``delivered``, carried through an exit.
        time_s: time of the last change of ``state``, s.
        detail: edge about which the parcel tipped, feeder at which it waits, or exit through which it left.
    """

    state: ParcelState
    time_s: float
    detail: str = ""

    @property
    def rides(self) -> bool:
        """Whether wheels carry the parcel, moving or at rest."""
        return self.state in ("moving", "at_rest")


@final
@dataclass(frozen=True, slots=True)
class Trajectory:
    """Sampled states and events of a plant under constant drives.

    Attributes:
        time_ns: instants, ``(T,)``, ns.
        state: states of all parcels, ``(T, parcels, 6)``.
        events: all events.
    """

    time_ns: NDArray[np.int64]
    state: Floats
    events: list[Event]


@final
@dataclass(frozen=True, slots=True)
class Transit:
    """Statistics of transit times, s."""

    mean: float
    shortest: float
    longest: float

    @classmethod
    def of(cls, spans_ns: Sequence[int]) -> Transit | None:
        """Summarise transit times; None if no parcel left."""
        if not spans_ns:
            return None
        return cls(sum(spans_ns) / len(spans_ns) * 1e-9, min(spans_ns) * 1e-9, max(spans_ns) * 1e-9)


@final
@dataclass(frozen=True, slots=True)
class FeedCount:
    """Statistics of one feeder.

    Attributes:
        name: of the feeder.
        fed: parcels fed.
        waiting: parcels not fed yet.
        held_back: parcels that were blocked at the first tick at which they were due, whether fed since or not.
        longest_hold_s: longest wait of a blocked parcel, s.
    """

    name: str
    fed: int
    waiting: int
    held_back: int
    longest_hold_s: float


@final
@dataclass(frozen=True, slots=True)
class ExitCount:
    """Statistics of one exit.

    Attributes:
        name: of the exit.
        left: number of parcels that left.
        misrouted: number of parcels among them meant for another exit.
        transit_s: time from feeding (the start, for the scene's own parcels) to leaving.
    """

    name: str
    left: int
    misrouted: int
    transit_s: Transit | None


@final
@dataclass(frozen=True, slots=True)
class TrafficCount:
    """Traffic statistics; every parcel is counted in one of ``waiting``, ``there`` and ``left``.

    Attributes:
        feed: by feeder.
        exits: by exit.
        waiting: parcels not fed yet.
        there: parcels on the array, tipped ones too.
        left: parcels that left by any exit.
        misrouted: those of them that were meant for another.
        transit_s: of all of these.
        left_per_s: the throughput; None before any time has passed.
    """

    feed: Sequence[FeedCount]
    exits: Sequence[ExitCount]
    waiting: int
    there: int
    left: int
    misrouted: int
    transit_s: Transit | None
    left_per_s: float | None
