"""Effect ``roller_drag``: rollers resist being rolled, ``f = -d N v`` along each wheel's free direction.

The rollers on a wheel's rim leave the direction across the wheel free. With the cell's load N and the velocity v of the
parcel's underside along that direction, their bearings and the rolling contact pull the parcel with ``-d N v``. A cell
has a wheel along each axis, so each axis is the free direction of one wheel, and the cell's drag is ``-d N (vx, vy)``.
The dissipation potential is ``d N |v|^2 / 2``, convex like those of the laws.
"""

from __future__ import annotations

from typing import ClassVar, Self, final

from bus.effect import EffectSpec
from bus.spec import Positive


@final
class RollerDragSpec(EffectSpec):
    """Rollers that resist being rolled along a wheel's free direction."""

    solvers: ClassVar[tuple[str, ...] | None] = ("implicit", "fixed_step", "quasi_static")
    fidelity_rank: ClassVar[int | None] = 25
    drag_s_per_m: Positive
    """Drag of a wheel's rollers per newton of load on the cell and per m/s along the wheel's free direction."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """A tenth of the viscous traction of the bundled scenes."""
        return cls(drag_s_per_m=0.02)
