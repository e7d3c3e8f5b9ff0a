"""Scene specifications of the cells: frozen, validated parts that concern firmware."""

from __future__ import annotations

from decimal import Decimal
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator

from bus.spec import CellName, Finite, NotNegative, Positive, Spec, Vector
from cell_firmware.board_presets import Board

__all__ = [
    "CellName",
    "CellsSpec",
    "Finite",
    "NotNegative",
    "Positive",
    "Spec",
    "SpeedLoopSpec",
    "Vector",
    "nanoseconds",
]


class SpeedLoopSpec(Spec):
    """Gains of the PI loop that closes on a motor.

    The defaults suit the default motor (0.1 m/s per volt, time constant 0.06 s): the integral gain is the
    proportional gain over the time constant, so that the loop's zero cancels the motor's pole. What
    remains is first order with a time constant of 0.05 s, and settles to 2 % in 0.2 s.
    """

    kp_v_per_m_s: NotNegative = 12.0
    """Proportional gain: volts per m/s of error."""
    ki_v_per_m: NotNegative = 200.0
    """Integral gain: volts per metre, which is per m/s of error and second."""
    feed_forward_v_per_m_s: NotNegative = 0.0
    """Feed-forward gain: volts per m/s of reference; 0: no feed-forward."""


class CellsSpec(Spec):
    """The firmware of the cells, and its control period."""

    firmware: Annotated[str, Field(min_length=1)] = "velocity_field"
    """A bundled name, ``package.module:Class``, or a path to a ``.py`` file, with or without ``:Class``."""
    period_s: Positive = 0.004096
    """The control period; the default is one real-time interrupt of an MC68HC11 at 8 MHz."""
    parameters: dict[str, Any] = {}  # noqa: RUF012 - pydantic copies it
    """Parameters of the firmware, which validates them."""
    initial_registers: dict[str, Any] = {}  # noqa: RUF012 - pydantic copies it
    """Variables of the program that begin with other values than those of its ``init``, after each power-on: by name, a
    value for every cell, or a table of values by ``"row,column"``."""
    board: Board | None = None
    """A board by name, or ``{ name, without }``: adds the board's effects except ``without`` to the scene's effects."""
    on_failure: Literal["stop", "isolate"] = "stop"
    """Handling of a failed program: ``stop`` ends the run in that tick with status ``failed``; ``isolate`` drops that
    cell alone, and its wheels follow ``stall.policy``."""
    speed_loop: SpeedLoopSpec | None = None
    """Gains of the speed loop; only for scenes with motors. Default: the default gains."""

    @field_validator("period_s")
    @classmethod
    def _whole_nanoseconds(cls, value: float) -> float:
        nanoseconds(value)
        return value

    @property
    def period_ns(self) -> int:
        """The control period, integer nanoseconds."""
        return nanoseconds(self.period_s)


def nanoseconds(seconds: float) -> int:
    """A positive time as integer nanoseconds, read as the decimal number that was written.

    Raises:
        ValueError: It is not a whole number of nanoseconds, or none at all.
    """
    exact = Decimal(repr(seconds)) * 1_000_000_000
    whole = int(exact)
    if whole < 1 or exact != whole:
        raise ValueError(f"must be a whole number of nanoseconds, at least 1, not {exact.normalize():f} ns")
    return whole
