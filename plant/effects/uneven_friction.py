"""Effect ``uneven_friction``: cells, and the two wheels of a cell, differ in friction.

Each wheel has a factor for all of the law's traction that is in proportion to the load: ``mu`` of ``viscous``,
``coulomb`` (static and kinetic alike), ``coulomb_sliding`` and ``stick_slip``. Factors are log-normal with mean 1 by
the scene's seed, one for each cell times one for each wheel, and named cells may have their own.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, Self, final

from pydantic import Field, field_validator, model_validator

from bus import elementary
from bus.effect import EffectSpec
from bus.lattice import Lattice
from bus.random_streams import rng
from bus.spec import CellName, NotNegative, Spec
from plant.wheels import Floats

Spread = Annotated[float, Field(ge=0, le=2, allow_inf_nan=False)]


class CellFrictionSpec(Spec):
    """Friction of one cell's wheels over the law's, in place of what is drawn."""

    cell: CellName
    factor: NotNegative | None = None
    """Both wheels."""
    factors: tuple[NotNegative, NotNegative] | None = None
    """Instead of ``factor``: the wheel along x, the wheel along y."""

    @model_validator(mode="after")
    def _one_of_two(self) -> CellFrictionSpec:
        if (self.factor is None) == (self.factors is None):
            raise ValueError("give factor or factors, one of the two")
        return self

    @property
    def both(self) -> tuple[float, float]:
        """Factors of the wheels along x and along y."""
        if self.factors is not None:
            return self.factors
        assert self.factor is not None
        return self.factor, self.factor


@final
class UnevenFrictionSpec(EffectSpec):
    """Cells and wheels of unequal friction."""

    solvers: ClassVar[tuple[str, ...] | None] = ("implicit", "fixed_step", "quasi_static")
    fidelity_rank: ClassVar[int | None] = 15
    cell_spread: Spread = 0.0
    """Standard deviation of the logarithm of the cells' log-normal factors, approximately their relative spread."""
    wheel_spread: Spread = 0.0
    """Standard deviation of the logarithm of the wheels' log-normal factors, which multiply those of their cells."""
    cells: tuple[CellFrictionSpec, ...] = ()
    """Cells with given factors."""

    @field_validator("cells")
    @classmethod
    def _once(cls, value: tuple[CellFrictionSpec, ...]) -> tuple[CellFrictionSpec, ...]:
        names = [friction.cell for friction in value]
        for row, column in names:
            if names.count((row, column)) > 1:
                raise ValueError(f"cells names [{row}, {column}] twice")
        return value

    @property
    def parts_wheels(self) -> bool:
        """Whether the two wheels of a cell may differ."""
        return self.wheel_spread > 0.0 or any(one.both[0] != one.both[1] for one in self.cells)

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """Cells that differ by a fifth."""
        return cls(cell_spread=0.2)

    def problems(
        self,
        lattice: Lattice,
        pitch_m: float,  # noqa: ARG002
    ) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """Listed cells that don't exist."""
        for number, friction in enumerate(self.cells):
            if friction.cell not in lattice:
                yield ("cells", number, "cell"), list(friction.cell), "the array has no cell there"


def friction_factors(spec: UnevenFrictionSpec, lattice: Lattice, seed: int) -> Floats:
    """Draw the factors of all wheels, ``(n, 2)``: along x, along y; and put in those that are given.

    Three numbers are drawn for every cell in row-major order, used or not: a cell with given factors changes no other.

    Args:
        spec: the effect's settings.
        lattice: which cells exist.
        seed: of the scene.
    """
    draw = rng(seed, "uneven_friction").standard_normal((len(lattice), 3))
    # the mean of exp(s g) is exp(s^2 / 2)
    cells = elementary.exp(spec.cell_spread * draw[:, :1] - 0.5 * spec.cell_spread**2)
    factors: Floats = cells * elementary.exp(spec.wheel_spread * draw[:, 1:] - 0.5 * spec.wheel_spread**2)
    for one in spec.cells:
        factors[lattice.index(one.cell)] = one.both
    return factors
