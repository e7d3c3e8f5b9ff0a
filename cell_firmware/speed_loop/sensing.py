"""Tachometers of speed loops: speed from the travel since the last control period."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Final, TypeVar, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.errors import FirmwareError
from cell_firmware.firmware import Floats, State

Integers = NDArray[np.int32]
_Number = TypeVar("_Number", np.float64, np.int32)

FRACTION_BITS: Final = 4
"""Of speeds in an integer loop: Q4, sixteenths of a count."""
LARGEST_WORD: Final = 2**15 - 1
"""Of a speed in Q4 where nothing is counted."""
LARGEST_DIFFERENCE: Final = 127
"""Counts either way that the difference of two 8-bit counts tells for certain."""


class Tachometer(ABC):
    """Tachometer of both wheels of n cells; the first reading is 0, whatever the wheels' positions.

    Attributes:
        unit_m_s: Speed that a reading of 1 stands for.
    """

    unit_m_s: float

    @abstractmethod
    def init(self, n: int) -> State:
        """Return the state after power-on: last reading, and ``seen`` ``(n, 1)``, whether there was one."""

    @abstractmethod
    def read(self, state: State, encoder_m: Floats) -> tuple[State, NDArray[Any]]:
        """The next state, and ``(n, 2)`` readings.

        Args:
            state: Of n cells.
            encoder_m: ``(n, 2)``, surface travel since the start, m.
        """

    @abstractmethod
    def describe(self, loop: NDArray[Any]) -> None:
        """Enter its kind and units into a record of ``kernels.speed_loop.LOOP``."""

    def registers(self, state: State) -> dict[str, NDArray[Any]]:  # noqa: ARG002
        """Return the readable registers."""
        return {}


class IntegerTachometer(Tachometer):
    """A tachometer whose readings are int32.

    Attributes:
        fraction_bits: How many of a reading's bits are a fraction of its unit; at most `FRACTION_BITS`.
        largest: Reading up to which, either way, it is right.
    """

    fraction_bits: int
    largest: int

    @property
    def step_m_s(self) -> float:
        """Speed that 1 in Q4 stands for."""
        return self.unit_m_s / (1 << (FRACTION_BITS - self.fraction_bits))


@final
class Travel(Tachometer):
    """The exact travel, over the period: readings are m/s.

    Args:
        period_s: The control period, s.
    """

    def __init__(self, period_s: float) -> None:
        self.unit_m_s = 1.0
        self._period_s = period_s

    def init(self, n: int) -> State:
        """Travel at the last reading, ``(n, 2)`` m."""
        return _travel_state(n)

    def describe(self, loop: NDArray[Any]) -> None:
        """Enter kind, unit, and period."""
        from cell_firmware.kernels.speed_loop import TRAVEL

        loop["tachometer"], loop["unit_m_s"], loop["period_s"] = TRAVEL, self.unit_m_s, self._period_s

    def read(self, state: State, encoder_m: Floats) -> tuple[State, Floats]:
        """Return the travel since the last reading over the period."""
        return _travelled(state, encoder_m, self._period_s)


@final
class FixedPointTachometer(IntegerTachometer):
    """The exact travel over the period as a 16-bit word in Q4, rounded to the nearest and saturating.

    What an integer loop reads where the scene has no encoder.

    Args:
        period_s: The control period, s.
        unit_m_s: Speed that 16 in the word stands for.
    """

    fraction_bits = FRACTION_BITS
    largest = LARGEST_WORD

    def __init__(self, period_s: float, unit_m_s: float) -> None:
        self.unit_m_s = unit_m_s / (1 << FRACTION_BITS)
        self._period_s = period_s

    def init(self, n: int) -> State:
        """Travel at the last reading, ``(n, 2)`` m."""
        return _travel_state(n)

    def describe(self, loop: NDArray[Any]) -> None:
        """Enter kind, unit, period, and range."""
        from cell_firmware.kernels.speed_loop import WORD

        loop["tachometer"], loop["unit_m_s"], loop["period_s"] = WORD, self.unit_m_s, self._period_s
        loop["largest"] = self.largest

    def read(self, state: State, encoder_m: Floats) -> tuple[State, Integers]:
        """Return the travel since the last reading over the period, in Q4."""
        after, speed = _travelled(state, encoder_m, self._period_s)
        return after, nearest(speed / self.unit_m_s, self.largest)


@final
class Encoder(IntegerTachometer):
    """Whole counts in an 8-bit counter that wraps: the pulse accumulator of an MC68HC11.

    The count is ``floor(travel / metres a count)`` modulo 256, and a reading the difference of two, as a signed byte:
    right while the wheel turns by at most 127 counts a period forwards and 128 backwards; beyond, it aliases.

    Args:
        period_s: The control period, s.
        m_per_count: Surface travel of a count, m.
    """

    fraction_bits = 0
    largest = LARGEST_DIFFERENCE

    def __init__(self, period_s: float, m_per_count: float) -> None:
        if not (np.isfinite(m_per_count) and m_per_count > 0.0):
            raise FirmwareError(f"encoder: m_per_count must be positive and finite, not {m_per_count}")
        self.unit_m_s = m_per_count / period_s
        self._m_per_count = m_per_count

    def init(self, n: int) -> State:
        """The last counts, ``(n, 2)`` uint8."""
        return {"count": np.zeros((n, 2), dtype=np.uint8), "seen": np.zeros((n, 1), dtype=np.bool_)}

    def describe(self, loop: NDArray[Any]) -> None:
        """Enter kind, unit, travel of a count, and by how many bits a reading is shifted to Q4."""
        from cell_firmware.kernels.speed_loop import COUNTER

        loop["tachometer"], loop["unit_m_s"], loop["m_per_count"] = COUNTER, self.unit_m_s, self._m_per_count
        loop["largest"], loop["fraction_shift"] = self.largest, FRACTION_BITS - self.fraction_bits

    def read(self, state: State, encoder_m: Floats) -> tuple[State, Integers]:
        """Signed differences modulo 256."""
        count = np.floor(encoder_m / self._m_per_count).astype(np.int64).astype(np.uint8)
        turned = (count - state["count"]).view(np.int8).astype(np.int32)
        after = {"count": count, "seen": np.ones_like(state["seen"])}
        return after, _once_seen(state, turned)

    def registers(self, state: State) -> dict[str, NDArray[Any]]:
        """The counters."""
        return {"count": state["count"]}


def nearest(value: Floats, largest: int) -> Integers:
    """Rounded to the nearest integer, ties to even, and no further from zero than ``largest``."""
    return np.rint(np.minimum(np.maximum(value, -largest), largest)).astype(np.int32)


def _travel_state(n: int) -> State:
    return {"encoder_m": np.zeros((n, 2)), "seen": np.zeros((n, 1), dtype=np.bool_)}


def _travelled(state: State, encoder_m: Floats, period_s: float) -> tuple[State, Floats]:
    speed = (encoder_m - state["encoder_m"]) / period_s
    after = {"encoder_m": encoder_m.copy(), "seen": np.ones_like(state["seen"])}
    return after, _once_seen(state, speed)


def _once_seen(state: State, reading: NDArray[_Number]) -> NDArray[_Number]:
    """The reading; 0 of cells that have not read before."""
    seen = state["seen"]
    return reading if seen.all() else np.where(seen, reading, reading.dtype.type(0))
