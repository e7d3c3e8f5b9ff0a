"""Effect ``roller_impacts``: a wheel's rollers strike the parcel as they pass under it.

The paper doubts that traction is viscous by nature: its dependence on speed may come from the rollers' impacts, whose
rate rises with the slip. One impulse ``impulse_s N`` for every ``spacing_m`` of slip r is a mean force of

    (impulse_s / spacing_m) N r

the viscous law's (eq. 14), with nothing viscous in it.
"""

from __future__ import annotations

from typing import Annotated, ClassVar, Self, final

from pydantic import Field

from bus.effect import EffectSpec
from bus.random_streams import rng
from bus.spec import Positive
from plant.wheels import Floats


@final
class RollerImpactsSpec(EffectSpec):
    """Wheels whose rollers strike the parcel."""

    solvers: ClassVar[tuple[str, ...] | None] = ("implicit",)
    states: ClassVar[tuple[str, ...]] = ("slip since the last roller, of every wheel and parcel",)
    fidelity_rank: ClassVar[int | None] = 50
    spacing_m: Annotated[float, Field(ge=1e-5, le=1.0, allow_inf_nan=False)]
    """Slip at a wheel from one roller to the next."""
    impulse_s: Positive
    """Impulse of one roller on the parcel along the wheel's axis, N s per newton of load on the cell."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """Rollers 4 mm apart that add 0.02 s/m to the scene's friction."""
        return cls(spacing_m=4e-3, impulse_s=8e-5)


def starts(cells: int, seed: int) -> Floats:
    """How far each wheel has turned at the start since a roller passed, in spacings, ``(cells, 2)`` in [0, 1).

    Args:
        cells: how many, two wheels each.
        seed: of the scene.
    """
    return rng(seed, "roller_impacts").random((cells, 2))
