"""Random numbers of cells' programs: a function of a stream's key, the count, and the cell."""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.jit import INTEGER, entry, kernel, read, written

WORD = np.uint64(0xFFFFFFFF)
HALF = np.uint64(32)
MULTIPLIER_0 = np.uint64(0xD2511F53)
MULTIPLIER_1 = np.uint64(0xCD9E8D57)
WEYL_0 = np.uint64(0x9E3779B9)
WEYL_1 = np.uint64(0xBB67AE85)
UPPER = np.uint64(21)
LOWER = np.uint64(11)


@kernel
def philox(c0, c1, c2, c3, k0, k1):
    """Encrypt a counter: Philox 4x32-10. All numbers are uint64 that hold words of 32 bits.

    Args:
        c0: First word of the counter.
        c1: Second word.
        c2: Third word.
        c3: Fourth word.
        k0: First word of the key.
        k1: Second word.

    Returns:
        Four words.

    Source: Salmon et al., "Parallel random numbers: as easy as 1, 2, 3", SC 2011.
    """
    for _ in range(10):
        p0, p1 = MULTIPLIER_0 * c0, MULTIPLIER_1 * c2
        c0, c1, c2, c3 = (p1 >> HALF) ^ c1 ^ k0, p1 & WORD, (p0 >> HALF) ^ c3 ^ k1, p0 & WORD
        k0, k1 = (k0 + WEYL_0) & WORD, (k1 + WEYL_1) & WORD
    return c0, c1, c2, c3


@kernel
def uniform(key, count, row, column):
    """Return the number of a cell in [0, 1), a multiple of 2⁻⁵³.

    Args:
        key: ``(2,)`` uint64, words of 32 bits: key of the stream.
        count: Of the draw, >= 0.
        row: Of the cell.
        column: Of the cell.
    """
    c = np.uint64(count)
    first, second, _, _ = philox(
        c & WORD, c >> HALF, np.uint64(row) & WORD, np.uint64(column) & WORD, key[0], key[1]
    )
    return np.float64((first << UPPER) | (second >> LOWER)) * 2.0**-53


@kernel
def draw_cell(keys, count, place, numbers):
    """Draw a cell's numbers.

    Args:
        keys: ``(k, 2)`` uint64, keys of the streams.
        count: Of the draw.
        place: ``(2,)``, row and column of the cell.
        numbers: ``(k,)``; is filled.
    """
    for j in range(len(numbers)):
        numbers[j] = uniform(keys[j], count, place[0], place[1])


@entry(read("u8", 2), INTEGER, read("i8", 1), read("i8", 1), written("f8", 2))
def draw(keys, count, rows, columns, numbers):
    """Draw the numbers of cells.

    Args:
        keys: ``(k, 2)``, keys of the streams.
        count: Of the draw.
        rows: ``(n,)``, and ...
        columns: ... ``(n,)`` of the cells.
        numbers: ``(k, n)``; is filled.
    """
    for j in range(len(keys)):
        for i in range(len(rows)):
            numbers[j, i] = uniform(keys[j], count, rows[i], columns[i])


@entry(read("u8", 1), read("u8", 1), written("u8", 1))
def encrypt(counter, key, words):
    """Encrypt one counter, to compare with published results; see ``philox``.

    Args:
        counter: ``(4,)`` words.
        key: ``(2,)`` words.
        words: ``(4,)``; is filled.
    """
    words[0], words[1], words[2], words[3] = philox(
        counter[0], counter[1], counter[2], counter[3], key[0], key[1]
    )
