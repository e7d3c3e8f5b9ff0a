"""Eight bytes at a time, from any place in rows of bytes: NumPy moves single bytes as slowly as whole words."""

from __future__ import annotations

from functools import lru_cache
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.effects.serial.framing import Bytes
from cell_firmware.effects.serial.timing import Ints
from cell_firmware.firmware import Messages

WORD: Final = 8
_MASKS: Final = np.array([(1 << 8 * n) - 1 for n in range(WORD + 1)], dtype="<u8")
"""A word's first n bytes."""


def copy_bytes(
    source: Bytes, source_at: Ints, target: Bytes, target_at: Ints, count: Ints, *, clean: bool = False
) -> None:
    """Copies ``count`` bytes in every row, from a place of the source's to one of the target's.

    Whole words are moved: behind the last byte up to seven more of the target's row change, and rows of both must have
    so many there.

    Args:
        source: ``(n, s)``, in one piece.
        source_at: ``(n,)``.
        target: ``(n, t)``, in one piece.
        target_at: ``(n,)``.
        count: ``(n,)``, may be 0.
        clean: Whether those that change become zero; else they are whatever the source has there.
    """
    words_in, words_out = _words(source), _words(target)
    from_ = _begins(*source.shape) + source_at
    to = _begins(*target.shape) + target_at
    most = int(count.max(initial=0))
    for done in range(0, most, WORD):
        if done:
            row = np.flatnonzero(count > done)
            from_, to, count = from_[row], to[row], count[row]
        words = words_in[from_ + done]
        words_out[to + done] = words & _MASKS[np.minimum(count - done, WORD)] if clean else words


@lru_cache(maxsize=8)
def _begins(rows: int, size: int) -> Ints:
    """Return the start of each row in a flat array of consecutive rows."""
    begins = np.arange(rows, dtype=np.int64) * size
    begins.setflags(write=False)
    return begins


def _words(rows: Bytes) -> NDArray[np.uint64]:
    """The word at each place of rows that lie one after another; the same memory."""
    return np.ndarray((max(rows.size - WORD + 1, 0),), "<u8", rows, strides=(1,))


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
        parts: As ``wire``, with ``byte``, an array of at least ``slots`` bytes, in place of the words.
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
