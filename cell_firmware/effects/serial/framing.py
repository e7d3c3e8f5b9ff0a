"""A message as the bytes that a line carries: its packed fields and a check byte."""

from __future__ import annotations

from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.wire.message_type import check_message, each_all, leaves, overlong
from cell_firmware.firmware import Bools, Messages

Bytes = NDArray[np.uint8]

_CHECK_START: Final = 0xFF


def bytes_of(message: np.dtype[Any]) -> int:
    """Return the length of a message on a line, bytes: its fields, packed, and a check byte."""
    return check_message(message).itemsize + 1


def check_of(data: Bytes) -> Bytes:
    """``(k,)`` check bytes of ``(k, size)`` bytes: CRC-8, polynomial x⁸ + x² + x + 1, from 255.

    It starts at 255 so that a line that only brings zeros does not bring a message. It finds every error within eight
    bits in a row; of what else happens to a message one in 256 slips through.
    """
    check = np.full(len(data), _CHECK_START, dtype=np.uint8)
    for column in np.ascontiguousarray(data.T):
        # times x^8, which is x^2 + x + 1; what goes beyond the eight bits by that, once again
        value = check ^ column
        over = value >> 7 ^ value >> 6
        check = value ^ value << 1 ^ value << 2 ^ over ^ over << 1 ^ over << 2
    return check


@final
class Frame:
    """Codec of messages of one type as bytes on a line.

    Args:
        message: The firmware's message type.

    Attributes:
        packed: Type of the messages' bytes.
        size: Bytes of a message.
        length: Bytes that go over the line for it: with the check byte.
    """

    def __init__(self, message: np.dtype[Any]) -> None:
        self.message = message
        self.packed = check_message(message)
        self.size = self.packed.itemsize
        self.length = self.size + 1

    def pack(self, messages: Messages) -> Bytes:
        """``(..., size)`` bytes of messages, little-endian."""
        packed = np.ascontiguousarray(messages, dtype=self.packed)
        return packed.view(np.uint8).reshape(*messages.shape, self.size)

    def unpack(self, frames: Bytes) -> tuple[Bools, Messages]:
        """Decode messages from ``(k, length)`` bytes; return which are valid, and the messages.

        Invalid values of a field's type (a boolean of 3, a NaN float) count as a wrong check byte, as no program sends
        such values.
        """
        data = np.ascontiguousarray(frames[:, : self.size])
        good = check_of(data) == frames[:, self.size]
        messages = data.view(self.packed)[:, 0]
        for leaf in leaves(self.packed):
            values = leaf.of(messages)
            if leaf.type.kind == "f":
                good &= each_all(np.isfinite(values), good.shape)
            elif leaf.type.kind == "b":
                good &= each_all(values.view(np.uint8) <= 1, good.shape)
        good &= ~overlong(messages, self.packed)
        return good, messages.astype(self.message)
