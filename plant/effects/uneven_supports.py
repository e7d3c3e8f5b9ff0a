"""Effect ``uneven_supports``: cells differ in spring rate and height, ``N_i = K_i (z(p_i) + h_i)+``, z the sag.

The paper's cells are equal springs at one height. Those of a real array are not, and a few carry most of the load.
Rates are log-normal about their mean, heights normal about zero, both by the scene's seed; named cells may have their
own.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated, ClassVar, Self, final

from pydantic import Field, field_validator

from bus import elementary
from bus.effect import EffectSpec
from bus.lattice import Lattice
from bus.random_streams import rng
from bus.spec import CellName, Finite, NotNegative, Positive, Spec
from plant.wheels import Floats


class SupportSpec(Spec):
    """Support of one cell; settings that are left out are drawn as for all cells."""

    cell: CellName
    stiffness_n_per_m: Positive | None = None
    height_m: Finite | None = None


@final
class UnevenSupportsSpec(EffectSpec):
    """Cells of unequal spring rates and heights."""

    solvers: ClassVar[tuple[str, ...] | None] = ("implicit", "fixed_step", "quasi_static")
    fidelity_rank: ClassVar[int | None] = 10
    stiffness_n_per_m: Positive
    """Mean spring rate of a cell."""
    stiffness_spread: Annotated[float, Field(ge=0, le=2, allow_inf_nan=False)] = 0.0
    """Standard deviation of the logarithm of the log-normal rates, approximately their relative spread."""
    height_spread_m: NotNegative = 0.0
    """Standard deviation of the normally distributed heights."""
    cells: tuple[SupportSpec, ...] = ()
    """Cells with given rate or height."""

    @field_validator("cells")
    @classmethod
    def _once(cls, value: tuple[SupportSpec, ...]) -> tuple[SupportSpec, ...]:
        names = [support.cell for support in value]
        for row, column in names:
            if names.count((row, column)) > 1:
                raise ValueError(f"cells names [{row}, {column}] twice")
        return value

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """Springs of 3 N/mm that differ by a fifth, at heights that differ by 0.1 mm."""
        return cls(stiffness_n_per_m=3e3, stiffness_spread=0.2, height_spread_m=1e-4)

    def problems(
        self,
        lattice: Lattice,
        pitch_m: float,  # noqa: ARG002
    ) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """Listed cells that don't exist."""
        for number, support in enumerate(self.cells):
            if support.cell not in lattice:
                yield ("cells", number, "cell"), list(support.cell), "the array has no cell there"


@final
@dataclass(frozen=True, slots=True)
class UnevenSupports:
    """Heights and stiffnesses of the cells' supports.

    Attributes:
        stiffness_n_per_m: mean stiffness, N/m.
        rate: stiffness of each cell over the mean, ``(n,)``.
        height_m: height without load, ``(n,)``, m.
    """

    stiffness_n_per_m: float
    rate: Floats
    height_m: Floats


def supports(spec: UnevenSupportsSpec, lattice: Lattice, seed: int) -> UnevenSupports:
    """Draw every cell's support, and put in those that are known.

    Two numbers are drawn for every cell in row-major order, used or not: giving one cell its own changes no other.

    Args:
        spec: the effect's settings.
        lattice: which cells exist.
        seed: of the scene.
    """
    draw = rng(seed, "uneven_supports").standard_normal((len(lattice), 2))
    spread = spec.stiffness_spread
    # the mean of exp(s g) is exp(s^2 / 2)
    rate: Floats = elementary.exp(spread * draw[:, 0] - 0.5 * spread * spread)
    height: Floats = spec.height_spread_m * draw[:, 1]
    for one in spec.cells:
        cell = lattice.index(one.cell)
        if one.stiffness_n_per_m is not None:
            rate[cell] = one.stiffness_n_per_m / spec.stiffness_n_per_m
        if one.height_m is not None:
            height[cell] = one.height_m
    return UnevenSupports(spec.stiffness_n_per_m, rate, height)
