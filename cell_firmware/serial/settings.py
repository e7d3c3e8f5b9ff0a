"""How the lines of every cell are set up."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.serial.rates import BITS_A_BYTE

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
    def room(self) -> int:
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
