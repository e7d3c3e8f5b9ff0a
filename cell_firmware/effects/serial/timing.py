"""How the lines of every cell are set up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.effects.serial.framing import Bytes
from cell_firmware.firmware import Bools, State

E_CLOCK_NS: Final = 500
"""Period of the E clock of an HC11 with a crystal of 8 MHz."""
BITS_A_BYTE: Final = 10
"""Start bit, eight data bits, the least first, stop bit."""
_FASTEST_BIT_CLOCKS: Final = 16
_PRESCALERS: Final = (1, 3, 4, 13)
_DIVIDERS: Final = tuple(1 << n for n in range(8))

BIT_CLOCKS: Final = {
    round(1_000_000_000 / (E_CLOCK_NS * clocks)): clocks
    for clocks in sorted({_FASTEST_BIT_CLOCKS * p * d for p in _PRESCALERS for d in _DIVIDERS})
}
"""E clocks a bit, by rate in baud to the nearest whole number: 125,000 / {1, 3, 4, 13} / 2^n."""


def bit_ns(baud: int) -> int:
    """How long a bit takes.

    Raises:
        ValueError: No SCI has this rate; names the nearest.
    """
    if baud not in BIT_CLOCKS:
        nearest = min(BIT_CLOCKS, key=lambda rate: abs(rate - baud))
        raise ValueError(
            f"must be a rate that an HC11 at 8 MHz has, 125000/{{1, 3, 4, 13}}/2^n: the nearest is {nearest}"
        )
    return E_CLOCK_NS * BIT_CLOCKS[baud]


Ints = NDArray[np.int64]

LONGEST_PERIOD_NS: Final = 1_000_000_000
"""So that what lines carry has room for when in a window it starts."""
_BILLION: Final = 1_000_000_000


@final
@dataclass(frozen=True, slots=True)
class LineSettings:
    """The lines of every cell.

    Attributes:
        bit_ns: How long a bit takes, even.
        period_ns: The control period: how often the firmware serves its lines. Both by a clock without error.
        ring_bytes: Places in the ring that interrupts fill; 0: the driver polls the register.
        polled_bytes: Bytes that a polling driver sends in a period.
        dwell_periods: Periods that one SCI stays on a side; None: a UART for each.
    """

    bit_ns: int
    period_ns: int
    ring_bytes: int = 16
    polled_bytes: int = 1
    dwell_periods: int | None = None

    @property
    def polled(self) -> bool:
        """Whether there are no interrupts."""
        return self.ring_bytes == 0

    @property
    def byte_ns(self) -> int:
        """How long a byte takes, start and stop bits with it."""
        return BITS_A_BYTE * self.bit_ns

    @property
    def buffer_bytes(self) -> int:
        """Bytes that can wait for the receiving cell: in its ring, or in the register."""
        return self.ring_bytes or 1

    def periods(self, length: int) -> int:
        """Periods within which ``length`` bytes go out that begin with one."""
        if self.polled:
            return -(-length // self.polled_bytes)
        return -(-length * self.byte_ns // self.period_ns)

    def problems(self, length: int) -> Iterator[str]:
        """Why frames of ``length`` bytes would never arrive; nothing if they can."""
        if self.period_ns > LONGEST_PERIOD_NS:
            yield f"a control period may be {LONGEST_PERIOD_NS} ns, not {self.period_ns}"
        if self.polled and self.polled_bytes * self.byte_ns > self.period_ns:
            yield (
                f"a driver that polls needs the {self.polled_bytes * self.byte_ns} ns of the bytes that it sends "
                f"in its period of {self.period_ns} ns"
            )
        dwell, periods = self.dwell_periods, self.periods(length)
        if dwell is not None and periods > dwell:
            yield f"a message of {length} bytes takes {periods} periods, and the switch stays on a side for {dwell}"

    def slots(self, length: int) -> int:
        """Most bytes of frames of ``length`` bytes that a cell sends on a side from one of its steps to the next."""
        if self.polled:
            return self.polled_bytes
        # One more than fit: a clock that errs may round a byte into either of two periods.
        return min(self.period_ns // self.byte_ns + 2, 2 * length)


def by_clock(span_ns: Ints | int, ppb: Ints | None) -> Ints | int:
    """How long it takes a clock that is slow by ``ppb`` (its periods are longer) to count a span, ns rounded down."""
    return span_ns if ppb is None else span_ns + span_ns * ppb // _BILLION


_STOP: Final = BITS_A_BYTE - 1


def sample_map(own_ppb: Ints, sender_ppb: Ints) -> Ints:
    """Which of the sender's bits each sample falls on.

    The start edge is seen at once and exactly; sample j = 0..9 is taken j + 1/2 of the receiver's bit times after it,
    and is the line's level there. (A real SCI looks sixteen times a bit and takes a majority: its limit is somewhat
    lower than the ideal one, 0.5 / 9.5 = 5.3 %.)

    Args:
        own_ppb: Errors of the receivers' clocks.
        sender_ppb: Of the senders', of a shape to go with it.

    Returns:
        ``(..., 10)``; 10 is what follows the stop bit. The identity where the clocks agree well enough.
    """
    half_bits = 2 * np.arange(BITS_A_BYTE) + 1
    return half_bits * (_BILLION + own_ppb[..., None]) // (2 * (_BILLION + sender_ppb[..., None]))


def sampled(value: Bytes, samples: Ints, followed: Bools) -> tuple[Bytes, Bools]:
    """Return the bytes that receivers sample.

    Args:
        value: ``(k,)``, as they were sent.
        samples: ``(k, 10)`` of ``sample_map``.
        followed: ``(k,)``: has the next byte's start bit begun when the stop bit is sampled? Else the line idles.

    Returns:
        The bytes that are read, and where the stop bit is no one: framing errors.
    """
    idle = np.where(followed, 0, 1 << BITS_A_BYTE)
    line: NDArray[np.int64] = value.astype(np.int64) << 1 | 1 << _STOP | idle
    read = np.zeros(len(value), dtype=np.int64)
    for j in range(1, _STOP):
        read |= (line >> samples[:, j] & 1) << (j - 1)
    return read.astype(np.uint8), (line >> samples[:, _STOP] & 1) == 0


_IDLE_BITS: Final = 9
"""Ones after a byte that make an idle character with its stop bit."""


@final
@dataclass(frozen=True, slots=True)
class LineTimes:
    """Times from a byte's start, ns; ``(n, 4)`` where cells have clocks of their own.

    Attributes:
        late_ns: How much later everything comes than it does on the line.
        byte_ns: To the next byte's start, by the sender's clock.
        come_ns: Until the byte is there: its stop bit is sampled, and what is late has come.
        idle_ns: Until an idle character has passed after it: ten ones, of which its stop bit is the first.
        stop_ns: Until the receiver samples its stop bit, by its own clock.
        samples: ``(n, 4, 10)`` of ``sample_map``; None where clocks are equal.
        skewed: Where samples miss their bits.
    """

    late_ns: int
    byte_ns: Ints | int
    come_ns: Ints | int
    idle_ns: Ints | int
    stop_ns: Ints | int
    samples: Ints | None = None
    skewed: Bools | None = None

    @staticmethod
    def of(
        settings: LineSettings, late_ns: int, own: Ints | None = None, sender: Ints | None = None
    ) -> LineTimes:
        """Return the times of lines with clock errors of receivers, ``(n, 1)``, and of senders, ``(n, 4)``, ppb."""
        bit = settings.bit_ns
        byte_ns = by_clock(settings.byte_ns, sender)
        come_ns = by_clock(19 * bit // 2, sender) + late_ns
        idle_ns = byte_ns + by_clock(_IDLE_BITS * bit, own)
        stop_ns = by_clock(19 * bit // 2, own)
        if own is None or sender is None:
            return LineTimes(late_ns, byte_ns, come_ns, idle_ns, stop_ns)
        samples = sample_map(own, sender)
        skewed = (samples != np.arange(BITS_A_BYTE)).any(axis=2)
        return LineTimes(late_ns, byte_ns, come_ns, idle_ns, stop_ns, samples, skewed)

    def state(self) -> State:
        """Return the times that vary by line, as state arrays."""
        lines = np.shape(self.byte_ns)
        return {name: np.broadcast_to(getattr(self, name), _shape(name, lines)).copy() for name in _VARYING}

    @staticmethod
    def from_state(late_ns: int, state: State) -> LineTimes:
        """Restore the times from the arrays of ``state``."""
        return LineTimes(late_ns, *(state[name] for name in _VARYING))


_VARYING: Final = ("byte_ns", "come_ns", "idle_ns", "stop_ns", "samples", "skewed")


def _shape(name: str, lines: tuple[int, ...]) -> tuple[int, ...]:
    return (*lines, BITS_A_BYTE) if name == "samples" else lines
