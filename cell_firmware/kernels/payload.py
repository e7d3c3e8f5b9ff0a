"""Payloads of a shard whose values have fixed positions: read into and written from the buffers of a tick."""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.jit import INTEGER, entry, kernel, read, written
from cell_firmware.kernels.memory import array_at

FIELD = np.dtype(
    [
        ("start", "<i8"),  # first byte
        ("size", "<i8"),
        ("buffer", "<i8"),  # address of as many bytes
        ("truth", "<i8"),  # whether each byte must be 0 or 1
        ("numbers", "<i8"),  # whether it is of float64 that must be finite
        ("item", "<i8"),  # bytes of a message, for fields of messages; else 0
    ]
)
"""Place of a field in a payload, and its buffer."""

BYTE = np.dtype(np.uint8)
TICK_BYTES = 8


@kernel
def is_finite(payload, start):
    """Whether the float64 at this place, the lowest byte first, is finite: not all bits of its exponent are set."""
    return (payload[start + 7] & 0x7F) != 0x7F or (payload[start + 6] & 0xF0) != 0xF0


@kernel
def read_tick(payload, start):
    """The unsigned integer at this place."""
    tick = np.int64(0)
    for b in range(TICK_BYTES):
        tick = (tick << 8) | payload[start + b]
    return tick


@entry(
    INTEGER, read("u1", 1), read("u1", 1), read("u1", 1), INTEGER, read(FIELD, 1), read("i8", 1),
)  # fmt: skip
def read_payload(tick, payload, constant, is_constant, tick_at, fields, booleans):
    """Read the values of a payload into their buffers.

    Args:
        tick: Of the payload.
        payload: ``(size,)``, all as long as ``constant``.
        constant: ``(size,)``, the constant bytes.
        is_constant: ``(size,)``, 1 where a byte is constant.
        tick_at: First byte of the tick, of 8 bytes, the highest first.
        fields: ``(f,)`` of ``FIELD``.
        booleans: ``(b,)``, places in a message of bytes that must be 0 or 1.

    Returns:
        Whether it is a payload of the tick with valid values; if not, buffers may have been written to.
    """
    for b in range(len(constant)):
        if is_constant[b] and payload[b] != constant[b]:
            return False
    if read_tick(payload, tick_at) != tick:
        return False
    for f in range(len(fields)):
        field = fields[f]
        buffer = array_at(field.buffer, field.size, BYTE)
        for b in range(field.size):
            buffer[b] = payload[field.start + b]
        if field.truth:
            for b in range(field.size):
                if buffer[b] > 1:
                    return False
        if field.numbers:
            for start in range(0, field.size, 8):
                if not is_finite(buffer, start):
                    return False
        if field.item:
            for start in range(0, field.size, field.item):
                for k in range(len(booleans)):
                    if buffer[start + booleans[k]] > 1:
                        return False
    return True


@entry(INTEGER, INTEGER, read(FIELD, 1), written("u1", 1))
def write_payload(tick, tick_at, fields, payload):
    """Write a tick and the values of the buffers into a payload.

    Args:
        tick: Of the payload.
        tick_at: As of ``read_payload``.
        fields: ``(f,)`` of ``FIELD``.
        payload: ``(size,)`` with the constant bytes; its values are filled.
    """
    for b in range(TICK_BYTES):
        payload[tick_at + b] = (tick >> (8 * (TICK_BYTES - 1 - b))) & 255
    for f in range(len(fields)):
        field = fields[f]
        buffer = array_at(field.buffer, field.size, BYTE)
        for b in range(field.size):
            payload[field.start + b] = buffer[b]
