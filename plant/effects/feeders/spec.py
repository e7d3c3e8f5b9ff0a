"""Effect ``feeders``: parcels appear at feeders, on a schedule or at random, and leave through exits.

All that is left to chance is drawn at the start from the scene's seed, so every parcel that will ever appear is known
from the first instant: they follow the scene's own in order, and wait off the surface until their time.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from fractions import Fraction
from typing import Annotated, ClassVar, Literal, final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from bus.effect import EffectSpec
from bus.random_streams import rng
from bus.spec import Finite, NotNegative, Vector
from plant import geometry
from plant.parcel_spec import ParcelSpec, PolygonSpec

Name = Annotated[str, Field(min_length=1)]
Time = Annotated[float, Field(ge=0, le=1e9, allow_inf_nan=False)]
Interval = Annotated[float, Field(gt=0, le=1e9, allow_inf_nan=False)]


class FeedSpec(ParcelSpec):
    """A feeder: where a kind of parcel appears, how often and when. Poses and speeds are those of its parcels."""

    name: Name
    count: Annotated[int, Field(ge=1, le=10_000)] | None = None
    """How many parcels; not with ``times_s``, which says it."""
    times_s: Annotated[tuple[Time, ...], Field(min_length=1, max_length=10_000)] | None = None
    """When each parcel is due, ascending."""
    every_s: Interval | None = None
    """Or one parcel at ``first_s`` and one every so often from then on."""
    mean_s: Interval | None = None
    """Or at random: the gaps between parcels, and from ``first_s`` to the first, are exponential with this mean."""
    first_s: Time = 0.0
    clear_m: NotNegative = 0.0
    """Held back, too, while another's centre of mass is nearer than this to where a parcel is to appear."""
    position_spread_m: tuple[NotNegative, NotNegative] = (0.0, 0.0)
    """Each parcel's place is off by up to this much along x and along y, either way, uniformly at random."""
    angle_spread_rad: NotNegative = 0.0
    """The same of its angle."""
    to: tuple[Name, ...] = ()
    """Exits that its parcels are meant for; none: they are meant for no exit."""
    order: Literal["turn", "random"] = "turn"
    """How: each exit in turn, or each parcel's at random."""

    @model_validator(mode="after")
    def _schedule(self) -> FeedSpec:
        if sum(way is not None for way in (self.times_s, self.every_s, self.mean_s)) != 1:
            raise ValueError("give times_s, every_s or mean_s, one of the three")
        if self.times_s is None:
            if self.count is None:
                raise ValueError("every_s and mean_s need a count")
        elif self.count is not None or self.first_s:
            raise ValueError("times_s says how many and when; leave count and first_s out")
        elif list(self.times_s) != sorted(self.times_s):
            raise ValueError("times_s must ascend")
        return self

    @model_validator(mode="after")
    def _exits(self) -> FeedSpec:
        if self.destination is not None:
            raise ValueError("its parcels' exits are given by to; leave destination out")
        return self

    @property
    def total(self) -> int:
        """How many parcels."""
        return len(self.times_s) if self.times_s is not None else self.count or 0

    def due_ns(self, seed: int) -> list[int]:
        """Return the feed times of all parcels, ns, ascending; times at a fixed interval are rounded once each."""
        if self.times_s is not None:
            return [_rounded_up(_decimal(time_s)) for time_s in self.times_s]
        first = _decimal(self.first_s)
        if self.every_s is not None:
            every = _decimal(self.every_s)
            return [_rounded_up(first + number * every) for number in range(self.total)]
        assert self.mean_s is not None
        draw = rng(seed, f"feeders.{self.name}.times")
        due, found = _rounded_up(first), list[int]()
        for gap_s in (self.mean_s * draw.standard_exponential(self.total)).tolist():
            due += round(gap_s * 1e9)
            found.append(due)
        return found

    def parcels(self, seed: int) -> Iterator[ParcelSpec]:
        """The parcels in the order in which they are fed, each where it will appear."""
        kind = ParcelSpec.model_validate({key: getattr(self, key) for key in ParcelSpec.model_fields})
        draw = rng(seed, f"feeders.{self.name}.poses")
        spread = (*self.position_spread_m, self.angle_spread_rad)
        off = (draw.uniform(-1.0, 1.0, (self.total, 3)) * spread).tolist()
        for (dx, dy, turn), to in zip(off, self.destinations(seed), strict=True):
            place = (self.position_m[0] + dx, self.position_m[1] + dy)
            pose = {"position_m": place, "angle_rad": self.angle_rad + turn}
            yield kind.model_copy(update={**pose, "destination": to})

    def destinations(self, seed: int) -> list[str | None]:
        """The exit that each parcel is meant for, in the order in which they are fed."""
        if not self.to:
            return [None] * self.total
        if self.order == "turn":
            return [self.to[number % len(self.to)] for number in range(self.total)]
        draw = rng(seed, f"feeders.{self.name}.exits")
        return [self.to[number] for number in draw.integers(len(self.to), size=self.total).tolist()]


class ExitSpec(PolygonSpec):
    """An exit: a parcel whose centre of mass is in it leaves."""

    name: Name
    position_m: Vector = (0.0, 0.0)
    """Of its frame's origin: the middle of a rectangle."""
    angle_rad: Finite = 0.0

    def corners(self) -> NDArray[np.float64]:
        """``(v, 2)`` corners in world coordinates, counter-clockwise."""
        pose = np.array([*self.position_m, self.angle_rad])
        return geometry.placed(geometry.counter_clockwise(self.polygon()), pose)


@final
class FeedersSpec(EffectSpec):
    """Parcels appear at feeders, on a schedule or at random by the seed, and leave through exits."""

    states: ClassVar[tuple[str, ...]] = ("waiting and delivered parcels",)
    events: ClassVar[tuple[str, ...]] = ("fed", "held_back", "left")
    feed: tuple[FeedSpec, ...] = ()
    exits: tuple[ExitSpec, ...] = ()

    @classmethod
    def default_settings(cls, pitch_m: float) -> str:  # noqa: ARG003
        """None."""
        return "only a scene can say what comes, where it comes and where it leaves"

    @model_validator(mode="after")
    def _names(self) -> FeedersSpec:
        for key, names in (("feed", self._named(self.feed)), ("exits", self._named(self.exits))):
            if names:
                raise ValueError(f'{key} has the name "{names[0]}" twice')
        return self

    @staticmethod
    def _named(parts: Iterable[FeedSpec | ExitSpec]) -> list[str]:
        return [name for name, times in Counter(part.name for part in parts).items() if times > 1]

    @property
    def total(self) -> int:
        """How many parcels all feeders have."""
        return sum(feed.total for feed in self.feed)

    def number(self, exit_name: str | None) -> int:
        """Return the exit's number on labels: its position in the scene, from 1; 0 for None."""
        return 0 if exit_name is None else 1 + [one.name for one in self.exits].index(exit_name)

    def parcels(self, seed: int) -> tuple[ParcelSpec, ...]:
        """All parcels that will ever appear, feeder by feeder."""
        return tuple(parcel for feed in self.feed for parcel in feed.parcels(seed))


def _decimal(time_s: float) -> Fraction:
    """The number as it was written."""
    return Fraction(repr(time_s))


def _rounded_up(time_s: Fraction) -> int:
    """The first whole nanosecond that is not before a time."""
    return math.ceil(time_s * 1_000_000_000)
