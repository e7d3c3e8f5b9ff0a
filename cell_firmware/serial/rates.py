"""The rates at which an MC68HC11's SCI can run, and how long a byte takes."""

from __future__ import annotations

from typing import Final

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
