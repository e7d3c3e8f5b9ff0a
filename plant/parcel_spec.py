"""A parcel, as a scene gives it."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator, model_validator

from bus.spec import Finite, Positive, Spec, Vector
from plant.geometry import PolygonError, check_convex, polar_moment_per_mass, rectangle


class PolygonSpec(Spec):
    """A convex polygon: a rectangle about its frame's origin, or corners in that frame."""

    size_m: tuple[Positive, Positive] | None = None
    """Length along its x and along its y: a rectangle."""
    vertices_m: tuple[Vector, ...] | None = None
    """Or a convex polygon in its own frame, in either direction round."""

    @model_validator(mode="after")
    def _footprint(self) -> PolygonSpec:
        if (self.size_m is None) == (self.vertices_m is None):
            raise ValueError("give size_m or vertices_m, one of the two")
        return self

    @field_validator("vertices_m")
    @classmethod
    def _convex(cls, value: tuple[Vector, ...] | None) -> tuple[Vector, ...] | None:
        if value is not None:
            try:
                check_convex(value)
            except PolygonError as error:
                raise ValueError(str(error)) from None
        return value

    def polygon(self) -> tuple[Vector, ...]:
        """Corners in its own frame."""
        if self.vertices_m is not None:
            return self.vertices_m
        assert self.size_m is not None
        return rectangle(*self.size_m)


class ParcelSpec(PolygonSpec):
    """A rigid parcel with a flat convex bottom. Poses refer to its centre of mass."""

    mass_kg: Positive
    inertia_kg_m2: Positive | None = None
    """About the centre of mass; default: a uniform plate's about its centroid."""
    centre_of_mass_m: Vector | None = None
    """In the parcel's frame; default: the centroid."""
    position_m: Vector
    angle_rad: Finite = 0.0
    velocity_m_s: Vector = (0.0, 0.0)
    angular_velocity_rad_s: Finite = 0.0
    destination: Annotated[str, Field(min_length=1)] | None = None
    """Name of the exit that it is meant for."""

    def moment_of_inertia_kg_m2(self) -> float:
        """About the centre of mass: as given, or a uniform plate's about its centroid."""
        return self.inertia_kg_m2 or self.mass_kg * polar_moment_per_mass(self.polygon())
