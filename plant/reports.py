"""What the plant tells: senses, events, how parcels fare, and its course."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, NamedTuple, final

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]
ParcelState = Literal["moving", "at_rest", "tipped", "off_array"]


@final
@dataclass(frozen=True, slots=True)
class Sense:
    """What the cells sense at an instant.

    Attributes:
        presence: ``(n, sensors)`` bool.
        encoder_m: ``(n, 2)`` surface passed since the start, m, read-only; None where there are no encoders.
    """

    presence: NDArray[np.bool_]
    encoder_m: Floats | None


class Event(NamedTuple):
    """Something that happened in the plant.

    Attributes:
        time_s: when.
        kind: ``support_gained``, ``support_lost``, ``load_vanished``, ``load_returned``, ``captured``, ``released``,
            ``outrun`` (a parcel outruns a wheel though its law says that none does), ``tipped``, ``off_array``,
            ``overlap`` or ``apart``.
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
    """How a parcel fares.

    Attributes:
        state: ``moving``; ``at_rest``; ``tipped``, and it stays where it tipped and carries no wheel; ``off_array``.
        time_s: since when.
        detail: about which edge it tipped.
    """

    state: ParcelState
    time_s: float
    detail: str = ""


@final
@dataclass(frozen=True, slots=True)
class Trajectory:
    """A plant's course under constant drives.

    Attributes:
        time_ns: ``(T,)`` instants.
        state: ``(T, parcels, 6)``.
        events: all of them.
    """

    time_ns: NDArray[np.int64]
    state: Floats
    events: list[Event]
