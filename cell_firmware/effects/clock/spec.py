"""Effect ``clock``: every cell has a crystal of its own, and an interrupt that began when it did."""

from __future__ import annotations

from collections.abc import Iterator
from decimal import Decimal
from typing import Annotated, ClassVar, Literal, Self, final

import numpy as np
from pydantic import Field, field_validator

from bus.lattice import Lattice
from bus.random_streams import CounterStream
from bus.spec import CellName, NotNegative, Spec
from cell_firmware.clocks import BILLION, ArrayClocks, CellClocks
from cell_firmware.effects.base import CellEffectSpec
from cell_firmware.specs import CellsSpec

WORST_PPM = 60_000.0
"""Greatest error; a UART stands less."""


def parts_per_billion(error_ppm: float) -> int:
    """An error in ppm as a whole number of ppb, read as the decimal number that was written.

    Raises:
        ValueError: It is none.
    """
    exact = Decimal(repr(error_ppm)) * 1_000
    if exact != int(exact):
        raise ValueError("must be a whole number of ppb: at most three decimal places")
    return int(exact)


class CellClockSpec(Spec):
    """One cell's own clock; what is left out is as every other's."""

    cell: CellName
    error_ppm: Annotated[float, Field(ge=-WORST_PPM, le=WORST_PPM, allow_inf_nan=False)] | None = None
    """By how much its periods are longer than nominal."""
    phase_s: NotNegative | None = None
    """Its first instant; less than a period."""

    @field_validator("error_ppm")
    @classmethod
    def _whole_ppb(cls, value: float | None) -> float | None:
        if value is not None:
            parts_per_billion(value)
        return value

    @field_validator("phase_s")
    @classmethod
    def _whole_ns(cls, value: float | None) -> float | None:
        if value is not None and Decimal(repr(value)) * BILLION % 1:
            raise ValueError("must be a whole number of nanoseconds")
        return value


@final
class ClockSpec(CellEffectSpec):
    """Cells step at instants of their own: their crystals are off, and their interrupts began at different times."""

    states: ClassVar[tuple[str, ...]] = ("every cell's count of periods and last drive", "waiting messages")
    messages: ClassVar[tuple[str, ...]] = (
        "an exchange serves a window",
        "messages between neighbours carry their place in it",
    )
    fidelity_rank: ClassVar[int | None] = 55
    error_ppm: Annotated[float, Field(ge=0, le=WORST_PPM, allow_inf_nan=False)] = 50.0
    """Cells' periods are off by up to so much, either way, evenly by the seed."""
    phase: Literal["random", "aligned"] = "random"
    """Whether a cell's first instant is drawn, evenly within a period, or 0 for all."""
    exchanges_per_period: Annotated[int, Field(ge=1, le=64)] = 1
    """Windows, of equal length, in the shortest period that the settings allow."""
    cells: tuple[CellClockSpec, ...] = ()
    """Cells whose clock is known."""

    @field_validator("error_ppm")
    @classmethod
    def _whole_ppb(cls, value: float) -> float:
        parts_per_billion(value)
        return value

    @field_validator("cells")
    @classmethod
    def _once(cls, value: tuple[CellClockSpec, ...]) -> tuple[CellClockSpec, ...]:
        seen: set[CellName] = set()
        for one in value:
            if one.cell in seen:
                raise ValueError(f"cells names {list(one.cell)} twice")
            seen.add(one.cell)
        return value

    @classmethod
    def default_settings(cls, pitch_m: float) -> Self:  # noqa: ARG003
        """Return the defaults: crystals of 50 ppm, at any phase."""
        return cls()

    def problems(
        self,
        lattice: Lattice,
        pitch_m: float,  # noqa: ARG002
    ) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """Yield listed cells that don't exist."""
        for number, one in enumerate(self.cells):
            if one.cell not in lattice:
                yield ("cells", number, "cell"), list(one.cell), "the array has no cell there"

    def fit_problems(self, cells: CellsSpec) -> Iterator[tuple[tuple[str | int, ...], object, str]]:
        """Yield phases beyond the period, and a number of windows that makes them shorter than a nanosecond."""
        for number, one in enumerate(self.cells):
            if one.phase_s is not None and _ns(one.phase_s) >= cells.period_ns:
                yield ("cells", number, "phase_s"), one.phase_s, "must be less than cells.period_s"
        if self.window_ns(cells.period_ns) < 1:
            rule = f"windows of less than a nanosecond in a period of {cells.period_ns} ns"
            yield ("exchanges_per_period",), self.exchanges_per_period, rule

    def window_ns(self, period_ns: int) -> int:
        """Return the length of an exchange window, ns; it does not depend on random draws."""
        known = [parts_per_billion(-one.error_ppm) for one in self.cells if one.error_ppm is not None]
        fastest = max([parts_per_billion(self.error_ppm), *known])
        return period_ns * (BILLION - fastest) // BILLION // self.exchanges_per_period

    @property
    def longest(self) -> float:
        """The longest period that the settings allow, over the nominal one."""
        known = [one.error_ppm for one in self.cells if one.error_ppm is not None]
        return 1.0 + max([self.error_ppm, *known]) / 1e6

    def clocks(self, lattice: Lattice, period_ns: int, seed: int) -> ArrayClocks:
        """Every cell's clock.

        Two numbers are drawn for every cell, used or not: giving one cell its own changes no other.

        Args:
            lattice: The cells.
            period_ns: Nominal, of control.
            seed: The scene's.
        """
        draws = CounterStream(seed, "clock", np.arange(len(lattice)))
        most = parts_per_billion(self.error_ppm)
        ppb = np.minimum((draws.uniform(0) * (2 * most + 1)).astype(np.int64) - most, most)
        phase_ns = (draws.uniform(1) * (period_ns if self.phase == "random" else 0)).astype(np.int64)
        for one in self.cells:
            cell = lattice.index(one.cell)
            if one.error_ppm is not None:
                ppb[cell] = parts_per_billion(one.error_ppm)
            if one.phase_s is not None:
                phase_ns[cell] = _ns(one.phase_s)
        return ArrayClocks(lattice, CellClocks(period_ns, self.window_ns(period_ns), ppb, phase_ns))


def _ns(seconds: float) -> int:
    return int(Decimal(repr(seconds)) * BILLION)
