"""Eight bytes at a time, from any place in rows of bytes: NumPy moves single bytes as slowly as whole words."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.serial.frames import Bytes
from cell_firmware.serial.settings import Ints

WORD: Final = 8
_MASKS: Final = np.array([(1 << 8 * n) - 1 for n in range(WORD + 1)], dtype="<u8")
"""A word's first n bytes."""


def copy_bytes(source: Bytes, source_at: Ints, target: Bytes, target_at: Ints, count: Ints) -> None:
    """Copies ``count`` bytes in every row, from a place of the source's to one of the target's.

    Behind them up to seven bytes of the target's row become zero: rows need so much room, as have the source's.

    Args:
        source: ``(n, s)``, in one piece.
        source_at: ``(n,)``.
        target: ``(n, t)``, in one piece.
        target_at: ``(n,)``.
        count: ``(n,)``, may be 0.
    """
    words_in, words_out = _words(source), _words(target)
    from_ = np.arange(len(source)) * source.shape[1] + source_at
    to = np.arange(len(target)) * target.shape[1] + target_at
    most = int(count.max(initial=0))
    for done in range(0, most, WORD):
        row = np.flatnonzero(count > done)
        if len(row) == len(count):
            words_out[to + done] = words_in[from_ + done] & _MASKS[np.minimum(count - done, WORD)]
        else:
            words_out[to[row] + done] = (
                words_in[from_[row] + done] & _MASKS[np.minimum(count[row] - done, WORD)]
            )


def _words(rows: Bytes) -> NDArray[np.uint64]:
    """The word at each place of rows that lie one after another; the same memory."""
    return np.ndarray((max(rows.size - WORD + 1, 0),), "<u8", rows, strides=(1,))
