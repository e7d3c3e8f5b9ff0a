"""Types into which steps write messages, so that a number that doesn't fit its field is kept until it is checked."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from bus.wire.message_type import leaves, with_numbers

_DOUBLE: Final = np.dtype("<f8")
_WIDEST: Final = np.dtype(np.longdouble) if np.finfo(np.longdouble).nmant >= 63 else None
"""A float that holds every 64-bit integer; None where the machine has none."""


def array_draft(message: np.dtype[Any]) -> np.dtype[Any]:
    """The message type with fields that hold what is written: floats of 64 bits, wider ones for 64-bit integers.

    NumPy casts what a program writes into an array: 300 becomes 44 in an unsigned byte, NaN becomes 0. A program on
    arrays is therefore stepped with a draft of its message type, and ``Outbox.settled`` rounds the draft.
    """
    return with_numbers(message, _draft)


def _draft(field: np.dtype[Any]) -> np.dtype[Any]:
    if field.kind in "iu" and field.itemsize == _DOUBLE.itemsize:
        return _WIDEST or field
    return _DOUBLE


# --- of compiled steps -----------------------------------------------------------------------------

WIDE: Final = {np.dtype(kind): np.dtype([("bits", kind), ("given", "<f8")]) for kind in ("<i8", "<u8")}
"""Drafts of 64-bit integers, which float64 would round: ``given`` is 0 if the number fits, and else what was written;
``bits`` is the integer, wrapped if it is too great, and 0 for a float that doesn't fit."""


def compiled_draft(message: np.dtype[Any]) -> np.dtype[Any]:
    """Return the type into which a compiled step writes messages: float64 a number, ``WIDE`` for 64-bit integers.

    So a number that doesn't fit its field is seen when the draft is rounded to the type of the message.
    """
    return with_numbers(message, lambda field: WIDE.get(field, np.dtype("<f8")), align=True)


def as_written(drafts: NDArray[Any]) -> NDArray[np.longdouble]:
    """Return the numbers that were written to drafts of 64-bit integers, exact where the machine has wide floats."""
    whole, given = drafts["bits"].astype(np.longdouble), drafts["given"]
    wrapped = whole + np.longdouble(2.0**64 if drafts["bits"].dtype.kind == "i" else -(2.0**64))
    return np.where(given == 0.0, whole, np.where(wrapped.astype(np.float64) == given, wrapped, given))


def plain_drafts(drafts: NDArray[Any], message: np.dtype[Any]) -> NDArray[Any]:
    """Return drafts of a compiled step as a step on arrays or in Python writes them (``array_draft``).

    Args:
        drafts: ``(...)`` of ``compiled_draft``.
        message: Type of the messages.
    """
    plain = np.zeros(drafts.shape, dtype=array_draft(message))
    for leaf in leaves(message):
        numbers, target = leaf.of(drafts), leaf.of(plain)
        if leaf.type in WIDE:  # a machine without wide floats has the integers themselves
            numbers = numbers["bits"] if target.dtype == leaf.type else as_written(numbers)
        target[...] = numbers
    return plain
