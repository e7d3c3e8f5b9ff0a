"""Effect ``load_transfer``: traction below a raised centre of mass shifts loads between cells.

Traction F acts on the underside, a height H below the centre of mass, so that loads balance about a load's centre at
``X - H F / W`` instead of about the centre of mass X: a parcel that brakes leans forward. Pitch and roll are
quasi-static, as the springs under the parcel are in all loads (eqs. 3-13).
"""

from __future__ import annotations

from typing import ClassVar, Self, final

from bus.effect import EffectSpec
from bus.spec import NotNegative


@final
class LoadTransferSpec(EffectSpec):
    """Loads that shift as traction accelerates a parcel below its centre of mass."""

    solvers: ClassVar[tuple[str, ...] | None] = ("implicit", "fixed_step")
    excludes: ClassVar[tuple[str, ...]] = ("parcel_contact", "roller_impacts")
    states: ClassVar[tuple[str, ...]] = ("shift of every parcel's loads",)
    fidelity_rank: ClassVar[int | None] = 51
    centre_of_mass_height_m: NotNegative
    """Height of the centre of mass above the underside of parcels that don't give their own."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:
        """Half a pitch."""
        return cls(centre_of_mass_height_m=0.5 * pitch_m)
