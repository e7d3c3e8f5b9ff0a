"""Payloads as bytes on the wire, and random changes of these bytes."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.random_streams import CounterStream
from bus.wire.message_type import check_message, leaves
from cell_firmware.effects.serial.bursts import WORD, BurstType
from cell_firmware.firmware import Messages

Bytes = NDArray[np.uint8]
Ints = NDArray[np.int64]

_DRAWN: Final = 6
"""Bytes of a draw, which has 53 bits."""


class PayloadView(ABC):
    """Byte view of link payloads.

    Attributes:
        width: Most bytes of a link in a tick.
    """

    width: int

    @abstractmethod
    def read(self, messages: Messages) -> tuple[Bytes, Ints]:
        """Return ``(m, width)`` bytes of ``(m,)`` messages, and the number of bytes of each."""

    @abstractmethod
    def write(self, messages: Messages, data: Bytes) -> Messages:
        """Return the messages with replaced bytes."""

    @staticmethod
    def of(carried: np.dtype[Any], said: np.dtype[Any]) -> PayloadView:
        """Return the byte view of payloads ``carried`` for messages ``said``: of whole messages, or of serial bytes."""
        if set(said.names or ()) <= set(carried.names or ()):
            return MessageBytes(said)
        words = sum(name.startswith("word_") for name in carried.names or ())
        return SerialBytes(BurstType(WORD * words))


@final
class MessageBytes(PayloadView):
    """Bytes of whole messages: the program's fields, packed and little-endian, without a time stamp.

    Args:
        said: Type of the program's messages.
    """

    def __init__(self, said: np.dtype[Any]) -> None:
        self._names: tuple[str, ...] = said.names or ()
        self._packed = check_message(said)
        self.width = self._packed.itemsize

    def read(self, messages: Messages) -> tuple[Bytes, Ints]:
        """Return the bytes of the program's fields."""
        packed = np.empty(len(messages), dtype=self._packed)
        for name in self._names:
            packed[name] = messages[name]
        return packed.view(np.uint8).reshape(len(messages), -1), np.full(len(messages), self.width)

    def write(self, messages: Messages, data: Bytes) -> Messages:
        """Replace the program's fields; a boolean is true unless its byte is 0."""
        values, after = np.ascontiguousarray(data).view(self._packed)[:, 0], messages.copy()
        for leaf in leaves(self._packed):
            value = leaf.of(values)
            leaf.of(after)[...] = value.view(np.uint8) != 0 if leaf.type.kind == "b" else value
        return after


@final
class SerialBytes(PayloadView):
    """Bytes on serial lines: values can change, numbers and times of bytes can't.

    Args:
        burst: Of what a line carries in a window.
    """

    def __init__(self, burst: BurstType) -> None:
        self._burst = burst
        self.width = burst.width

    def read(self, messages: Messages) -> tuple[Bytes, Ints]:
        """Return the bytes of both runs."""
        parts = self._burst.from_wire(messages)
        count = parts["bytes_1"].astype(np.int64) + parts["bytes_2"]
        return parts["byte"].copy(), np.minimum(count, self.width)

    def write(self, messages: Messages, data: Bytes) -> Messages:
        """Replace the bytes of both runs."""
        parts = self._burst.from_wire(messages).copy()
        parts["byte"] = data
        return self._burst.to_wire(parts)


def flipped(data: Bytes, count: Ints, bits: int, chance: NDArray[np.float64]) -> Bytes:
    """Flip ``bits`` different bits of each row; all bits where there are no more.

    Args:
        data: ``(m, width)``.
        count: ``(m,)``, how many of them there are.
        bits: How many bits of each row.
        chance: ``(m, bits)``, in [0, 1): which.
    """
    after, row = data.copy(), np.arange(len(data))
    chosen = np.full((len(data), bits), 8 * data.shape[1] + bits)  # ascending; beyond the last: none yet
    for number in range(bits):
        left = 8 * count - number
        bit = (chance[:, number] * left).astype(np.int64)  # of those that are left
        for earlier in range(number):
            bit += bit >= chosen[:, earlier]
        some = left > 0
        after[row[some], bit[some] // 8] ^= (1 << bit[some] % 8).astype(np.uint8)
        chosen[some, number] = bit[some]
        chosen.sort(axis=1)
    return after


def random_bytes(draws: CounterStream, tick: int, rows: int, width: int) -> Bytes:
    """Return ``(rows, width)`` random bytes, of draws with ``random_bytes_each(width)`` numbers a row."""
    numbers = (draws.uniform(tick) * 2.0 ** (8 * _DRAWN)).astype("<u8").reshape(rows, -1, 1)
    return numbers.view(np.uint8)[..., :_DRAWN].reshape(rows, -1)[:, :width]


def random_bytes_each(width: int) -> int:
    """Return the number of draws for ``width`` bytes."""
    return -(-width // _DRAWN)
