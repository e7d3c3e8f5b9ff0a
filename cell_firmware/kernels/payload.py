"""Payloads of a shard whose values have fixed positions: read into and written from the buffers of a tick."""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.jit import INTEGER, entry, kernel, read, written
from cell_firmware.kernels.memory import array_at, copy_memory

FIELD = np.dtype(
    [
        ("start", "<i8"),  # first byte
        ("size", "<i8"),
        ("buffer", "<i8"),  # address of as many bytes
        ("truth", "<i8"),  # whether each byte must be 0 or 1
        ("numbers", "<i8"),  # whether it is of float64 that must be finite
        ("item", "<i8"),  # bytes of a message, for fields of messages; else 0
        (
            "bits",
            "<i8",
        ),  # booleans of the buffer, if they have a bit each, the first the lowest of a byte; else 0
    ]
)
"""Place of a field in a payload, and its buffer."""

BYTE = np.dtype(np.uint8)


@kernel
def is_finite(payload, start):
    """Whether the float64 at this place, the lowest byte first, is finite: not all bits of its exponent are set."""
    return (payload[start + 7] & 0x7F) != 0x7F or (payload[start + 6] & 0xF0) != 0xF0


@kernel
def read_tick(payload, start, size):
    """The unsigned integer at this place."""
    tick = np.int64(0)
    for b in range(size):
        tick = (tick << 8) | payload[start + b]
    return tick


@kernel
def is_same(payload, constant, begin, end):
    """Whether the bytes from ``begin`` on, before ``end``, are the constant ones."""
    for b in range(begin, end):
        if payload[b] != constant[b]:
            return False
    return True


@kernel
def read_bits(payload, start, bits, buffer):
    """Read booleans of a bit each; return whether all bits beyond the last are zero."""
    whole = bits // 8
    for k in range(whole):
        byte = payload[start + k]
        for b in range(8):
            buffer[8 * k + b] = (byte >> b) & 1
    if bits == 8 * whole:
        return True
    last = payload[start + whole]
    for b in range(bits - 8 * whole):
        buffer[8 * whole + b] = (last >> b) & 1
    return last >> (bits - 8 * whole) == 0


@entry(
    INTEGER, read("u1", 1), read("u1", 1), INTEGER, INTEGER, read(FIELD, 1), read("i8", 1),
)  # fmt: skip
def read_payload(tick, payload, constant, tick_at, tick_bytes, fields, booleans):
    """Read the values of a payload into their buffers.

    Args:
        tick: Of the payload.
        payload: ``(size,)``.
        constant: ``(size,)``, the payload with anything in the place of values.
        tick_at: First byte of the tick, the highest.
        tick_bytes: Bytes of the tick.
        fields: ``(f,)`` of ``FIELD``, in the order of the payload, all after the tick.
        booleans: ``(b,)``, places in a message of bytes that must be 0 or 1.

    Returns:
        Whether it is a payload of the tick with valid values; if not, buffers may have been written to.
    """
    begin = tick_at + tick_bytes
    if not is_same(payload, constant, 0, tick_at) or read_tick(payload, tick_at, tick_bytes) != tick:
        return False
    for f in range(len(fields)):
        field = fields[f]
        if not is_same(payload, constant, begin, field.start):
            return False
        begin = field.start + field.size
        if field.bits:
            if not read_bits(payload, field.start, field.bits, array_at(field.buffer, field.bits, BYTE)):
                return False
            continue
        buffer = array_at(field.buffer, field.size, BYTE)
        copy_memory(payload[field.start : field.start + field.size], buffer)
        if field.truth:
            wrong = np.uint8(0)
            for b in range(field.size):  # without a way out: many at a time
                wrong |= buffer[b] & 0xFE
            if wrong:
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
    return is_same(payload, constant, begin, len(constant))


@entry(INTEGER, INTEGER, INTEGER, read(FIELD, 1), written("u1", 1))
def write_payload(tick, tick_at, tick_bytes, fields, payload):
    """Write a tick and the values of the buffers into a payload.

    Args:
        tick: Of the payload.
        tick_at: First byte of the tick, the highest.
        tick_bytes: Bytes of the tick.
        fields: ``(f,)`` of ``FIELD``; none has bits.
        payload: ``(size,)`` with the constant bytes; its values are filled.
    """
    for b in range(tick_bytes):
        payload[tick_at + b] = (tick >> (8 * (tick_bytes - 1 - b))) & 255
    for f in range(len(fields)):
        field = fields[f]
        buffer = array_at(field.buffer, field.size, BYTE)
        copy_memory(buffer, payload[field.start : field.start + field.size])
