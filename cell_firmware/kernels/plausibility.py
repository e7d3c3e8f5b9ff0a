"""Refusal of implausible messages, as ``cell_firmware.refusals.refuse`` defines it.

Programs' kernels call ``refuse`` by its address (``memory.call_at``): it is compiled once.
"""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.jit import INTEGER, entry, kernel
from cell_firmware.kernels.memory import array_at, clear_memory

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
def signed_at(address, size):
    """Return a signed little-endian number of 1, 2, 4 or 8 bytes."""
    if size == 8:
        return array_at(address, 1, np.int64)[0]
    if size == 4:
        return np.int64(array_at(address, 1, np.int32)[0])
    if size == 2:
        return np.int64(array_at(address, 1, np.int16)[0])
    return np.int64(array_at(address, 1, np.int8)[0])


@kernel
def number_at(kind, address, size):
    """Return a number of a message as float64."""
    if kind == FLOAT:
        if size == 8:
            return array_at(address, 1, np.float64)[0]
        return np.float64(array_at(address, 1, np.float32)[0])
    number = signed_at(address, size)
    if kind == SIGNED:
        return np.float64(number)
    if kind == BOOLEAN:
        return np.float64(number != 0)
    if size < 8:
        number &= (1 << (8 * size)) - 1
    return np.float64(np.uint64(number))


@kernel
def is_plausible(checks, message):
    """Whether the numbers of a message at an address lie in their ranges, ``(c,)`` of ``CHECK``."""
    for c in range(len(checks)):
        one = checks[c]
        if one.length_size:
            length = number_at(UNSIGNED, message + one.length_start, one.length_size)
            if length <= one.place:
                continue
        number = number_at(one.kind, message + one.start, one.size)
        if not (number >= one.low and number <= one.high):  # which no NaN is
            return False
    return True


@entry(INTEGER, INTEGER, INTEGER, INTEGER, INTEGER)
def refuse(checks, count, received, message, size):
    """Drop the implausible messages of a cell.

    Args:
        checks: Address of ``(count,)`` of ``CHECK``.
        count: How many there are.
        received: Address of ``(4,)`` bool, the sides with a message; is made false where it is dropped.
        message: Address of ``(4, size)`` uint8, the messages; is made zero there.
        size: Bytes of a message.

    Returns:
        How many were dropped.
    """
    each, there = array_at(checks, count, CHECK), array_at(received, 4, np.bool_)
    messages, refused = array_at(message, (4, size), np.uint8), 0
    for side in range(4):
        if there[side] and not is_plausible(each, message + side * size):
            there[side] = False
            clear_memory(messages[side])
            refused += 1
    return refused
