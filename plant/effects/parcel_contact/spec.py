"""Effect ``parcel_contact``: parcels, and fixed guide rails, touch instead of passing through each other.

See ``plant.effects.parcel_contact`` for how contacts are found and what they do.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Literal, Self, final

from pydantic import Field, field_validator

from bus.effect import EffectSpec
from bus.spec import NotNegative, Positive, Vector
from plant.geometry import PolygonError, check_convex

SLOW_PITCHES_S = 1e-2
"""Approach speed up to which bodies don't bounce, pitches a second."""


@final
class ParcelContactSpec(EffectSpec):
    """Parcels touch each other and guide rails: reported, or resolved with impacts and friction."""

    solvers: ClassVar[tuple[str, ...] | None] = ("exact", "implicit")
    states: ClassVar[tuple[str, ...]] = ("pairs that touch",)
    events: ClassVar[tuple[str, ...]] = ("contact", "apart", "contact_residual", "parted")
    mode: Literal["report_only", "resolved"] = "resolved"
    """Mode: ``report_only`` detects contacts without effect on the motion; ``resolved`` adds impacts and friction."""
    restitution: Annotated[float, Field(ge=0, le=1, allow_inf_nan=False)] = 0.0
    """Newton's coefficient of restitution: separation speed over approach speed."""
    bounce_speed_m_s: Positive | None = None
    """Approach speed up to which bodies don't bounce; default: 0.01 pitches a second. Restitution has its full value
    from twice that speed on."""
    impacts: Literal["simultaneous", "sequential"] = "simultaneous"
    """Rule where several pairs touch at an instant: all strike at once, or one after another, the fastest first."""
    friction: NotNegative = 0.0
    """Coulomb coefficient at the touching edges."""
    rails: tuple[tuple[Vector, ...], ...] = ()
    """Guide rails, fixed, in world coordinates: two points are a segment, more a convex polygon."""
    step_s: Positive = 1e-3
    """Longest step while parcels press on each other or on a rail."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """The defaults, without rails: parcels push each other."""
        return cls()

    def slow_m_s(self, pitch_m: float) -> float:
        """Return the approach speed up to which impacts don't bounce, m/s."""
        given = self.bounce_speed_m_s
        return SLOW_PITCHES_S * pitch_m if given is None else given

    @field_validator("rails")
    @classmethod
    def _rails(cls, value: tuple[tuple[Vector, ...], ...]) -> tuple[tuple[Vector, ...], ...]:
        for number, rail in enumerate(value):
            try:
                if len(rail) != 2:
                    check_convex(rail)
                elif rail[0] == rail[1]:
                    raise PolygonError("both ends are the same point")
            except PolygonError as error:
                raise ValueError(f"rail {number}: {error}") from None
        return value
