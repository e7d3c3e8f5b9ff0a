"""Drafts of messages, eight bytes a number: checked against the fields of the wire type, and rounded to them."""

from __future__ import annotations

from typing import Any

import numpy as np

from bus.wire.message_type import bounded_lists
from cell_firmware.kernels.jit import kernel
from cell_firmware.kernels.program import draft_type
from cell_firmware.message_values import FieldValue, bounds, overflow, values_of

RAW, REAL, WHOLE = 0, 1, 2
"""Numbers of a draft: 64-bit integers as they are, float64 for a float, float64 for an integer or a truth value."""

VALUE = np.dtype(
    [
        ("kind", "<i8"),
        ("start", "<i8"),  # first byte in the message
        ("size", "<i8"),  # bytes in the message
        ("low", "<f8"),  # least number that fits
        ("high", "<f8"),  # greatest
    ]
)
"""A number of a message, in the order of the draft."""

LIST = np.dtype([("length", "<i8"), ("items", "<i8"), ("item", "<i8"), ("most", "<i8")])
"""A list in a message: places of its length and of its items in the draft, numbers of an item, and most items."""


def value_records(message: np.dtype[Any]) -> np.ndarray[Any, np.dtype[Any]]:
    """Return the numbers of a message type, ``(w,)`` of ``VALUE``."""
    return np.array([_value_record(value) for value in values_of(message)], dtype=VALUE)


def _value_record(value: FieldValue) -> tuple[int, int, int, float, float]:
    size, limit = value.type.itemsize, np.inf
    if value.type.kind == "f":
        limit = np.nextafter(overflow(value.type), 0.0)
        return REAL, value.start, size, -limit, limit
    if value.type.kind == "b":
        return WHOLE, value.start, size, 0.0, 1.0
    if size == VALUE["start"].itemsize:
        return RAW, value.start, size, -limit, limit
    low, high = bounds(value.type, value.leaf.most)
    return WHOLE, value.start, size, low, high


def list_records(message: np.dtype[Any]) -> np.ndarray[Any, np.dtype[Any]]:
    """Return the lists of a message type, ``(l,)`` of ``LIST``, outer ones first."""
    places = {value.start: place for place, value in enumerate(values_of(message))}
    ends = {**places, message.itemsize: len(places)}
    found: list[tuple[int, int, int, int]] = []
    for one in bounded_lists(message):
        items, end = places[one.items_start], ends[one.items_start + one.most * one.item_bytes]
        found.append((places[one.start], items, (end - items) // one.most, one.most))
    return np.array(found, dtype=LIST)


def is_whole_draft(message: np.dtype[Any]) -> bool:
    """Whether a draft of a message is the message itself, byte for byte."""
    return all(value.type.itemsize == draft_type(value.type).itemsize for value in values_of(message))


@kernel
def clear_beyond(lists, draft):
    """Make the items beyond the length of every list zero, in a draft ``(w,)`` of float64."""
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
        draft: ``(w,)`` float64; ``RAW`` numbers have other bits, and fit.
    """
    for word in range(len(values)):
        kind, number = values[word].kind, draft[word]
        if kind != RAW:
            if not (number >= values[word].low and number <= values[word].high):  # which no NaN is
                return word
            if kind == WHOLE and np.floor(number) != number:
                return word
    return -1


@kernel
def round_draft(values, draft, bits, message):
    """Round a draft whose numbers fit to the wire type.

    Args:
        values: ``(w,)`` of ``VALUE``.
        draft: ``(w,)`` float64.
        bits: ``(w,)``, the same memory as int64.
        message: ``(size,)`` uint8, the packed message; is filled.
    """
    for word in range(len(values)):
        value = values[word]
        number = bits[word]
        if value.kind == WHOLE:
            number = np.int64(draft[word])
        elif value.size == 4:
            number = np.int64(np.float32(draft[word]).view(np.int32))
        for byte in range(value.size):
            message[value.start + byte] = (number >> (8 * byte)) & 255
