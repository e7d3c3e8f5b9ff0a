"""Effect ``fixed_point``: speed loops compute in integers."""

from __future__ import annotations

from typing import ClassVar, Final, Self, final

from bus.spec import Positive
from cell_firmware.effects.base import CellEffectSpec

SPEED_UNIT_M_S: Final = 1e-3


@final
class FixedPointSpec(CellEffectSpec):
    """Speed loops compute in integers, speeds in Q4, voltages in Q12, with the same gains as in floating point."""

    needs: ClassVar[tuple[str, ...]] = ("motors",)
    fidelity_rank: ClassVar[int | None] = 46
    speed_unit_m_s: Positive | None = None
    """Unit of speeds without ``encoder``, default 0.001; with ``encoder`` the unit is a count a period. Speeds are
    16-bit words in sixteenths of the unit, and saturate at 2,048 units."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """The defaults."""
        return cls()

    @property
    def unit_m_s(self) -> float:
        """Unit of speeds without an encoder, m/s."""
        return self.speed_unit_m_s or SPEED_UNIT_M_S
