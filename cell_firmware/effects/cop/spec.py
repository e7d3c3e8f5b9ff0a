"""Effect ``cop``: the watchdog, which resets a cell whose program no longer serves it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, Final, Self, final

from pydantic import Field, field_validator

from bus.spec import Positive
from cell_firmware.effects.base import CellEffectSpec
from cell_firmware.specs import CellsSpec

DIVIDER_S: Final = 0.016384
"""Of the MC68HC11 at 8 MHz: 2^15 cycles of its E clock of 2 MHz, after which the watchdog's counter goes on by one."""
TIMEOUTS_S: Final = tuple(count * DIVIDER_S for count in (1, 4, 16, 64))
"""Those that the MC68HC11 can be set to."""


@final
class CopSpec(CellEffectSpec):
    """A watchdog resets cells whose program hangs.

    A program that raises hangs, and its cell is not lost: its pins keep what they had until the watchdog resets it.
    """

    states: ClassVar[tuple[str, ...]] = (
        "when each watchdog was served, drives of hung cells, cells that restart",
    )
    timeout_s: Positive
    """0.016384, 0.065536, 0.262144 or 1.048576: that long after the last service, and less than 0.016384 more."""
    reboot_s: Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)] = 0.05
    """From the reset until the program starts, wheels at 0."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """65.536 ms."""
        return cls(timeout_s=TIMEOUTS_S[1])

    @field_validator("timeout_s")
    @classmethod
    def _one_of_the_chip_s(cls, value: float) -> float:
        if value not in TIMEOUTS_S:
            raise ValueError(f"must be one of {', '.join(map(str, TIMEOUTS_S))}")
        return value

    def fit_problems(self, cells: CellsSpec) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """A timeout within which no program can serve."""
        if cells.period_s >= self.timeout_s:
            rule = f"must be longer than cells.period_s, {cells.period_s:g}: programs serve once a period"
            yield ("timeout_s",), self.timeout_s, rule
