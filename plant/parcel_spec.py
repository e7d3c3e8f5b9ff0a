"""Parcels and the array, as a scene gives them."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, field_validator, model_validator

from bus.lattice import Lattice
from bus.spec import CellName, Finite, NotNegative, Positive, Spec, Vector
from plant.geometry import PolygonError, check_convex, polar_moment_per_mass, rectangle


class PolygonSpec(Spec):
    """A convex polygon: a rectangle about its frame's origin, or corners in that frame."""

    size_m: tuple[Positive, Positive] | None = None
    """Rectangle: length along the frame's x and along its y."""
    vertices_m: tuple[Vector, ...] | None = None
    """Convex polygon, instead of ``size_m``: corners in the frame, in either direction round."""

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
    """Moment of inertia about the centre of mass; default: of a uniform plate about its centroid."""
    centre_of_mass_m: Vector | None = None
    """Centre of mass in the parcel's frame; default: the centroid."""
    centre_of_mass_height_m: NotNegative | None = None
    """Height of the centre of mass above the underside, which only ``effects.load_transfer`` uses; default: that of the
    effect."""
    position_m: Vector
    angle_rad: Finite = 0.0
    velocity_m_s: Vector = (0.0, 0.0)
    angular_velocity_rad_s: Finite = 0.0
    destination: Annotated[str, Field(min_length=1)] | None = None
    """Name of the exit for which the parcel is destined."""

    def moment_of_inertia_kg_m2(self) -> float:
        """About the centre of mass: as given, or a uniform plate's about its centroid."""
        return self.inertia_kg_m2 or self.mass_kg * polar_moment_per_mass(self.polygon())


class ArraySpec(Spec):
    """The lattice of cells, centred on the origin; row 0 at the bottom, column 0 at the left."""

    rows: Annotated[int, Field(ge=1, le=10_000)]
    columns: Annotated[int, Field(ge=1, le=10_000)]
    pitch_m: Positive = 0.1
    missing: tuple[CellName, ...] = ()
    """Holes: cells that do not exist."""
    cells: tuple[CellName, ...] | None = None
    """Arbitrary layout: the cells that exist (excludes ``missing``)."""
    sensors_m: Annotated[tuple[Vector, ...], Field(min_length=1, max_length=5)] = ((0.0, 0.0),)
    """Positions of the presence sensors relative to the cell centre, one to five."""

    @model_validator(mode="after")
    def _layout(self) -> ArraySpec:
        if self.cells is not None and self.missing:
            raise ValueError("give cells or missing, not both")
        for name, listed in (("missing", self.missing), ("cells", self.cells or ())):
            for row, column in listed:
                if row >= self.rows:
                    raise ValueError(f"{name} has [{row}, {column}]: the array has rows 0..{self.rows - 1}")
                if column >= self.columns:
                    raise ValueError(
                        f"{name} has [{row}, {column}]: the array has columns 0..{self.columns - 1}"
                    )
            if len(set(listed)) != len(listed):
                raise ValueError(f"{name} names a cell twice")
        if self.cells == () or len(self.missing) == self.rows * self.columns:
            raise ValueError("the array has no cells")
        return self

    @property
    def count(self) -> int:
        """Number of cells."""
        return self.rows * self.columns - len(self.missing) if self.cells is None else len(self.cells)

    def lattice(self) -> Lattice:
        """The cells that exist."""
        if self.cells is not None:
            return Lattice(self.cells)
        holes = set(self.missing)
        return Lattice((r, c) for r in range(self.rows) for c in range(self.columns) if (r, c) not in holes)
