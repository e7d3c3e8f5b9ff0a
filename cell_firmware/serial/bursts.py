"""What a line carries in a window of the exchange: two runs of bytes, in a flat type that any wire form takes."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from cell_firmware.firmware import Messages
from cell_firmware.serial.words import WORD


@final
class BurstType:
    """Two types of the same bytes: one for the wire, one to compute with.

    A sender ends one message and begins another within a period at most, and between its idle characters bytes follow
    each other without a gap. So a window's bytes are two runs at most, and a run needs one time: byte j starts j byte
    times, by the sender's clock, after the run does. On the wire the bytes go eight to a word.

    Args:
        slots: Most bytes in a window.

    Attributes:
        width: Bytes in all words.
        wire: Flat: of each run the number of bytes, and its start in ns since the window's beginning; words.
        parts: The same with ``byte``, an array of at least ``slots`` bytes, in place of the words.
    """

    def __init__(self, slots: int) -> None:
        words = -(-slots // WORD)
        runs = [("bytes_1", "<u2"), ("start_1_ns", "<u4"), ("bytes_2", "<u2"), ("start_2_ns", "<u4")]
        self.wire: np.dtype[Any] = np.dtype([*runs, *((f"word_{i}", "<u8") for i in range(words))])
        self.width = words * WORD
        self.parts: np.dtype[Any] = np.dtype([*runs, ("byte", "u1", (self.width,))])

    def to_wire(self, bursts: Messages) -> Messages:
        """Bursts of ``parts`` as ``wire``: the same memory."""
        return bursts.view(self.wire)

    def from_wire(self, bursts: Messages) -> Messages:
        """Bursts of ``wire`` as ``parts``: the same memory where it lies without gaps."""
        return np.ascontiguousarray(bursts, dtype=self.wire).view(self.parts)
