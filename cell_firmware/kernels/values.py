"""Drafts of messages, in words of eight bytes: checked against the fields of the wire type, and rounded to them."""

from __future__ import annotations

from itertools import accumulate
from typing import Any

import numpy as np

from bus.wire.message_type import bounded_lists
from cell_firmware.kernels.jit import kernel
from cell_firmware.message_drafts import WIDE
from cell_firmware.message_values import FieldValue, bounds, overflow, values_of

BITS, REAL, WHOLE = 0, 1, 2
"""Numbers of a draft: ``WIDE`` for 64-bit integers, float64 for a float, float64 for an integer or a truth value."""

VALUE = np.dtype(
    [
        ("kind", "<i8"),
        ("word", "<i8"),  # first one in the draft, of 8 bytes
        ("start", "<i8"),  # first byte in the message
        ("size", "<i8"),  # bytes in the message
        ("low", "<f8"),  # least number that fits
        ("high", "<f8"),  # greatest
    ]
)
"""A number of a message, in the order of the draft."""

LIST = np.dtype([("length", "<i8"), ("items", "<i8"), ("item", "<i8"), ("most", "<i8")])
"""A list in a message: words of its length and of its first item in the draft, words of an item, and most items."""


def value_records(message: np.dtype[Any]) -> np.ndarray[Any, np.dtype[Any]]:
    """Return the numbers of a message type, ``(w,)`` of ``VALUE``."""
    places = _places(message)
    records = [_value_record(value, word) for value, word in zip(values_of(message), places, strict=False)]
    return np.array(records, dtype=VALUE)


def _places(message: np.dtype[Any]) -> list[int]:
    """Return the first word in the draft of each number of a message type, and the number of words."""
    return list(accumulate((2 if value.type in WIDE else 1 for value in values_of(message)), initial=0))


def _value_record(value: FieldValue, word: int) -> tuple[int, int, int, int, float, float]:
    size, limit = value.type.itemsize, np.inf
    if value.type.kind == "f":
        limit = np.nextafter(overflow(value.type), 0.0)
        return REAL, word, value.start, size, -limit, limit
    if value.type.kind == "b":
        return WHOLE, word, value.start, size, 0.0, 1.0
    if value.type in WIDE:
        return BITS, word, value.start, size, -limit, limit
    low, high = bounds(value.type, value.leaf.most)
    return WHOLE, word, value.start, size, low, high


def list_records(message: np.dtype[Any]) -> np.ndarray[Any, np.dtype[Any]]:
    """Return the lists of a message type, ``(l,)`` of ``LIST``, outer ones first."""
    starts = [*(value.start for value in values_of(message)), message.itemsize]
    words = dict(zip(starts, _places(message), strict=True))
    found: list[tuple[int, int, int, int]] = []
    for one in bounded_lists(message):
        items, end = words[one.items_start], words[one.items_start + one.most * one.item_bytes]
        found.append((words[one.start], items, (end - items) // one.most, one.most))
    return np.array(found, dtype=LIST)


def draft_words(message: np.dtype[Any]) -> int:
    """Return how many words of 8 bytes a draft of a message has."""
    return _places(message)[-1]


def is_whole_draft(message: np.dtype[Any]) -> bool:
    """Whether a draft of a message is the message itself, byte for byte: all its numbers are float64."""
    return all(value.type == np.float64 for value in values_of(message))


@kernel
def clear_beyond(lists, draft):
    """Make the items beyond the length of every list zero, in a draft ``(words,)`` of float64."""
    for i in range(len(lists)):
        length = draft[lists[i].length]
        if length >= 0.0 and length <= lists[i].most:
            begin = lists[i].items + np.int64(length) * lists[i].item
            for word in range(begin, lists[i].items + lists[i].most * lists[i].item):
                draft[word] = 0.0


@kernel
def first_misfit(values, draft):
    """Return the place of the first number of a draft that doesn't fit its field; -1: all fit.

    Args:
        values: ``(w,)`` of ``VALUE``.
        draft: ``(words,)`` float64.
    """
    for place in range(len(values)):
        kind, word = values[place].kind, values[place].word
        if kind == BITS:
            if draft[word + 1] != 0.0:  # NaN too
                return place
            continue
        in_range = draft[word] >= values[place].low and draft[word] <= values[place].high  # which no NaN is
        if not in_range or (kind == WHOLE and np.floor(draft[word]) != draft[word]):
            return place
    return -1


@kernel
def round_draft(values, draft, bits, message):
    """Round a draft whose numbers fit to the wire type.

    Args:
        values: ``(w,)`` of ``VALUE``.
        draft: ``(words,)`` float64.
        bits: ``(words,)``, the same memory as int64.
        message: ``(size,)`` uint8, the packed message; is filled.
    """
    for place in range(len(values)):
        value = values[place]
        number = bits[value.word]
        if value.kind == WHOLE:
            number = np.int64(draft[value.word])
        elif value.size == 4:
            number = np.int64(np.float32(draft[value.word]).view(np.int32))
        for byte in range(value.size):
            message[value.start + byte] = (number >> (8 * byte)) & 255
