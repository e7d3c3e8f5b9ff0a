"""Effect ``pwm``: motors get voltages by pulses of whole timer counts."""

from __future__ import annotations

from typing import Annotated, ClassVar, Final, Self, final

from pydantic import Field, model_validator

from cell_firmware.effects.base import CellEffectSpec

TIMER_HZ: Final = 2_000_000
"""Counts a second of the free-running timer: the E clock at 8 MHz."""
USUAL_LEVELS: Final = 2_000


@final
class PwmSpec(CellEffectSpec):
    """Voltages are whole timer counts of a pulse period, sign and magnitude; the mean of a period acts."""

    needs: ClassVar[tuple[str, ...]] = ("motors",)
    states: ClassVar[tuple[str, ...]] = ("duty of every wheel",)
    messages: ClassVar[tuple[str, ...]] = ("drives are whole duties",)
    fidelity_rank: ClassVar[int | None] = 44
    levels: Annotated[int, Field(ge=1, le=65_535)] | None = None
    """Timer counts of a pulse period: 2 MHz over the frequency. Default without ``frequency_hz``: 2,000 (1 kHz)."""
    frequency_hz: Annotated[float, Field(ge=31, le=TIMER_HZ, allow_inf_nan=False)] | None = None
    """Pulse frequency, instead of ``levels``; rounded to a frequency of the timer."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """The defaults."""
        return cls()

    @model_validator(mode="after")
    def _one_of_two(self) -> PwmSpec:
        if self.levels is not None and self.frequency_hz is not None:
            raise ValueError("give levels or frequency_hz, not both")
        return self

    @property
    def counts(self) -> int:
        """Timer counts of a pulse period."""
        if self.frequency_hz is not None:
            return round(TIMER_HZ / self.frequency_hz)
        return self.levels or USUAL_LEVELS
