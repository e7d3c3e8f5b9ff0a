"""What a receiver reads of a byte whose sender's clock is not its own."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Bools
from cell_firmware.serial.frames import Bytes
from cell_firmware.serial.rates import BITS_A_BYTE
from cell_firmware.serial.settings import Ints

_BILLION: Final = 1_000_000_000
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
    """What receivers make of bytes.

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
