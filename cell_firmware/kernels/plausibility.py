"""Plausibility of a received message, as ``cell_firmware.refusals.refuse`` defines it.

Programs' kernels call it by its address (``memory.call_at``): it is compiled once.
"""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.jit import INTEGER, entry, kernel
from cell_firmware.kernels.lines import read_number
from cell_firmware.kernels.memory import array_at

UNSIGNED, SIGNED, FLOAT, BOOLEAN = 0, 1, 2, 3

CHECK = np.dtype(
    [
        ("kind", "<i8"),
        ("start", "<i8"),  # first byte in the message
        ("size", "<i8"),  # bytes
        ("low", "<f8"),  # least plausible number
        ("high", "<f8"),  # greatest
        ("length_start", "<i8"),  # first byte of the length of the list it is in, ...
        ("length_size", "<i8"),  # ... bytes of this length; 0: it is always looked at
        ("place", "<i8"),  # its place in the list: looked at if the length is greater
    ]
)
"""A number of a message that is to lie in a range."""


@kernel
def number_at(data, one):
    """Return the number of a check as float64."""
    number = read_number(data, one.start, one.size)
    if one.kind == FLOAT:
        if one.size == 4:
            return np.float64(np.int32(number).view(np.float32))
        return np.int64(number).view(np.float64)
    if one.kind == BOOLEAN:
        return np.float64(number != 0)
    unused = 64 - 8 * one.size
    if one.kind == SIGNED:
        return np.float64(number << unused >> unused)
    return np.float64(np.uint64(number))


@entry(INTEGER, INTEGER, INTEGER, INTEGER)
def is_plausible(checks, count, message, size):
    """Whether a message is plausible.

    Args:
        checks: Address of ``(count,)`` of ``CHECK``.
        count: How many there are.
        message: Address of its bytes.
        size: How many there are.

    Returns:
        1 or 0.
    """
    each, data = array_at(checks, count, CHECK), array_at(message, size, np.uint8)
    for c in range(count):
        one = each[c]
        if one.length_size and read_number(data, one.length_start, one.length_size) <= one.place:
            continue
        number = number_at(data, one)
        if not (number >= one.low and number <= one.high):  # which no NaN is
            return 0
    return 1
