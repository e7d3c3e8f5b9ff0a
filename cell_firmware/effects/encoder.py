"""Effect ``encoder``: wheels whose travel is known in whole counts, of 8 bits."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final, Literal, Self, final

from pydantic import Field

from bus.spec import Positive
from cell_firmware.effects.base import CellEffectSpec

RADIUS_M: Final = 0.03
"""Default radius of a wheel."""
_TURN: Final = 2.0 * 3.141592653589793


@final
class EncoderSpec(CellEffectSpec):
    """Speed loops read whole encoder counts modulo 256, not the exact travel.

    Without a decoder chip the pulse accumulator counts the first wheel's encoder, and an interrupt on input capture
    counts the second wheel's encoder in software, with 8 bits too: one edge of one channel a count. With decoder chips,
    each wheel's chip counts all four edges, and the program reads the low byte. All counters count in both directions.
    """

    needs: ClassVar[tuple[str, ...]] = ("motors",)
    states: ClassVar[tuple[str, ...]] = ("counts of every encoder",)
    fidelity_rank: ClassVar[int | None] = 42
    counts_per_revolution: Annotated[int, Field(ge=1, le=65_536)] = 256
    """Counts per revolution of a wheel; a decoder counts each cycle of its two channels four times."""
    decoder: Literal["hctl2016"] | None = None
    """Quadrature decoder of each wheel; None: the processor's accumulator and input capture. Decoders cost no
    interrupts; the results of a run don't depend on it."""
    wheel_radius_m: Positive | None = None
    """Radius of the wheels. Default: the radius in ``motors.dc``, else 0.03; if both are given, they must be equal."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """The defaults."""
        return cls()

    def m_per_count(self, motors_m: float | None) -> float:
        """Surface travel of a count.

        Args:
            motors_m: Radius of the motors' wheels; None where they have none.
        """
        return _TURN * (self.wheel_radius_m or motors_m or RADIUS_M) / self.counts_per_revolution
