"""Effect ``serial``: messages between neighbours go over serial lines, byte by byte."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, ClassVar, Final, Literal, Self, final

from pydantic import Field, field_validator, model_validator

from cell_firmware.effects.base import CellEffectSpec
from cell_firmware.effects.serial.timing import LineSettings, bit_ns
from cell_firmware.specs import CellsSpec

_DWELL_PERIODS: Final = 8


@final
class SerialSpec(CellEffectSpec):
    """Messages between neighbours go over serial lines: ten bits a byte, timed at the sender's clock.

    A message consists of its packed fields and a check byte. A message that is longer than a period can carry spans
    periods; while it is sent, only the newest later message of the firmware waits.
    """

    states: ClassVar[tuple[str, ...]] = (
        "bytes under way, messages half sent and half received, of every link",
    )
    messages: ClassVar[tuple[str, ...]] = ("links carry the bytes of a tick instead of messages",)
    fidelity_rank: ClassVar[int | None] = 75
    baud: int = 9615
    """Bit rate: 125,000 / {1, 3, 4, 13} / 2^n, rounded to a whole number."""
    ring_bytes: Literal[0, 16] = 16
    """Size of each receiver's ring buffer, which interrupts fill; 0: the firmware polls the register each period."""
    bytes_per_period: Annotated[int, Field(ge=1, le=2)] | None = None
    """Bytes that a polling driver sends in a period, default 1; a register that is polled once receives one byte."""
    sharing: Literal["quad_uart", "mux"] = "quad_uart"
    """A UART for each side, or the one SCI behind a switch that scans the sides."""
    dwell_periods: Annotated[int, Field(ge=1, le=10_000)] | None = None
    """Number of periods that the switch stays on a side, default 8."""

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """9,615 baud, a UART a side."""
        return cls()

    @field_validator("baud")
    @classmethod
    def _possible(cls, value: int) -> int:
        bit_ns(value)
        return value

    @model_validator(mode="after")
    def _of_use(self) -> SerialSpec:
        if self.ring_bytes and self.bytes_per_period is not None:
            raise ValueError("bytes_per_period is for a driver that polls: ring_bytes must be 0")
        if self.sharing != "mux" and self.dwell_periods is not None:
            raise ValueError('dwell_periods is for the one SCI: sharing must be "mux"')
        return self

    def settings(self, period_ns: int) -> LineSettings:
        """Return the line settings at this control period."""
        dwell = (self.dwell_periods or _DWELL_PERIODS) if self.sharing == "mux" else None
        return LineSettings(bit_ns(self.baud), period_ns, self.ring_bytes, self.bytes_per_period or 1, dwell)

    def fit_problems(self, cells: CellsSpec) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """Yield settings with which no message of the firmware would ever arrive."""
        from cell_firmware.effects.serial.framing import bytes_of
        from cell_firmware.errors import FirmwareError
        from cell_firmware.loader import find

        try:
            message = find(cells.firmware).message
        except FirmwareError:
            return  # which is another problem
        if message is not None:
            for problem in self.settings(cells.period_ns).problems(bytes_of(message)):
                yield (), None, problem
