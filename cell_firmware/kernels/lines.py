"""Links of one cell between its program and the wire: serial lines message by message, and mailboxes.

As ``cell_firmware.effects.serial.message_level`` and ``cell_firmware.effects.clock.mailbox`` define them. Serial lines
byte by byte are in ``cell_firmware.kernels.uarts``.
"""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.clock import by_clock
from cell_firmware.kernels.jit import kernel
from cell_firmware.kernels.messages import clear, copy

SERIAL = 1
"""Kind of links: messages arrive by a serial line; ..."""
MAILBOX = 2
"""... in a mailbox; ..."""
BYTES = 3
"""... by a serial line, byte by byte."""

NEVER = np.iinfo(np.int64).max
HEAD = 8
"""Bytes before a message. On a serial line: int32, when its last byte began; uint32, how many windows ago it began. For
a mailbox: int64, when in its window it was sent."""

LINES = np.dtype(
    [
        ("kind", "<i8"),
        ("window_ns", "<i8"),
        ("period_ns", "<i8"),
        ("byte_ns", "<i8"),
        ("length", "<i8"),
        ("slots", "<i8"),
        ("uarts", "<i8"),
        ("receive", "<i8"),
        ("send", "<i8"),
        ("idle", "<i8"),
    ]
)
"""Constants of links; the last four are addresses, of a record of ``uarts.UARTS`` and functions of that module."""

LINE = np.dtype(
    [
        # in every tick
        ("since", "<i8", (1,)),
        ("ppb", "<i8", (1,)),
        ("reaches", "u1", (4,)),
        ("waits", "u1", (4,)),
        ("goes", "u1", (4,)),
        ("last_ns", "<i8", (4,)),
        ("free_ns", "<i8", (4,)),
        ("replaced", "<i8", (4,)),
        # where a message begins, ends or arrives
        ("began", "<i8", (4,)),
        ("sent", "<i8", (4,)),
        ("whole_ns", "<i8", (4,)),
        ("received", "<i8", (4,)),
    ],
    align=True,
)
"""State of a cell's links, without the messages and the times at which these arrive; a mailbox uses ``waits`` and
``replaced`` of it."""


@kernel
def read_number(data, first, size):
    """An unsigned little-endian number."""
    number = np.int64(0)
    for b in range(size):
        number |= np.int64(data[first + b]) << (8 * b)
    return number


@kernel
def write_number(data, first, size, number):
    """Write the lower bytes of a number, little-endian."""
    for b in range(size):
        data[first + b] = (number >> (8 * b)) & 255


@kernel
def receive_serial(k, cell, there_ns, there, window, at_ns, line_received, line, received, message):
    """One exchange of a cell's serial lines.

    Args:
        k: Record of ``LINES``.
        cell: Record of ``LINE``.
        there_ns: ``(slots, 4)``, when what the lines carried in the last windows arrives; ``NEVER``: it has, or nothing
            came.
        there: ``(slots, 4, size)`` uint8, what they carried.
        window: Of the exchange.
        at_ns: When the cell reads; -1: it doesn't.
        line_received: ``(4,)``, which lines carry something.
        line: ``(4, size)`` uint8, what they carry.
        received: ``(4,)``, which sides have a message for the program; is filled.
        message: ``(4, size)`` uint8, zeros; is filled.
    """
    sent_in = window - 1
    if cell.since[0] < 0:
        cell.since[0] = sent_in
    new = window % k.slots
    for side in range(4):
        arrives_ns = NEVER
        if line_received[side]:
            last_ns = np.int64(np.int32(read_number(line[side], 0, 4)))
            if sent_in - read_number(line[side], 4, 4) >= cell.since[0]:
                arrives_ns = sent_in * k.window_ns + last_ns + cell.whole_ns[side]
                copy(line[side], there[new, side])
        if there_ns[new, side] != arrives_ns:  # what isn't written needn't go back to memory
            there_ns[new, side] = arrives_ns
    slot = new
    for _ in range(k.slots):  # the oldest first
        slot += 1
        if slot == k.slots:
            slot = 0
        for side in range(4):
            if there_ns[slot, side] <= at_ns:
                there_ns[slot, side] = NEVER
                cell.received[side] += k.length
                received[side] = True
                copy(there[slot, side, HEAD:], message[side])


@kernel
def send_serial(k, cell, waiting, going, window, at_ns, sent, message, line_sent, line):
    """Send what of a cell's messages ends before its next step.

    Args:
        k: Record of ``LINES``.
        cell: Record of ``LINE``.
        waiting: ``(4, size)`` uint8, messages that wait; ...
        going: ... and those whose bytes are on the way.
        window: Of the exchange.
        at_ns: When the cell writes.
        sent: ``(4,)``, to which sides the program sends.
        message: ``(4, size)`` uint8, its messages.
        line_sent: ``(4,)``, all false; is filled.
        line: ``(4, size)`` uint8, zeros; is filled.
    """
    next_ns = at_ns + by_clock(k.period_ns, cell.ppb[0])
    byte_ns = by_clock(k.byte_ns, cell.ppb[0])
    for side in range(4):
        if sent[side]:
            if cell.reaches[side]:
                if cell.waits[side]:
                    cell.replaced[side] += 1
                cell.waits[side] = 1
            copy(message[side], waiting[side])
        goes = cell.goes[side] != 0
        ends = goes and cell.last_ns[side] < next_ns
        begins = cell.waits[side] != 0 and (ends or not goes) and cell.free_ns[side] < next_ns
        at_once = False
        if ends:
            write_line(k, cell, side, window, going[side], line[side])
        if begins:
            last_ns = max(cell.free_ns[side], at_ns) + (k.length - 1) * byte_ns
            cell.last_ns[side] = last_ns
            cell.free_ns[side] = last_ns + 2 * byte_ns
            cell.began[side] = window
            cell.waits[side] = 0
            at_once = last_ns < next_ns and not ends
            if at_once:
                write_line(k, cell, side, window, waiting[side], line[side])
            else:
                copy(waiting[side], going[side])
        cell.goes[side] = (goes and not ends) or (begins and not at_once)
        if ends or at_once:
            line_sent[side] = True
            cell.sent[side] += k.length


@kernel
def write_line(k, cell, side, window, message, line):
    """Write a message as a line carries it."""
    write_number(line, 0, 4, cell.last_ns[side] - window * k.window_ns)
    write_number(line, 4, 4, window - cell.began[side])
    copy(message, line[HEAD:])


@kernel
def receive_mailbox(k, cell, waiting, at_ns, line_received, line, received, message):
    """One exchange of a cell's mailboxes; arguments as of ``receive_serial``."""
    steps, into_ns = at_ns >= 0, at_ns % k.window_ns
    for side in range(4):
        waits, came = cell.waits[side] != 0, line_received[side]
        in_time = came and steps and read_number(line[side], 0, 8) <= into_ns
        if came and waits and (in_time or not steps):
            cell.replaced[side] += 1
        if in_time:
            received[side] = True
            copy(line[side, HEAD:], message[side])
        elif waits and steps:
            received[side] = True
            copy(waiting[side], message[side])
        stays, remains = came and not in_time, waits and not steps
        cell.waits[side] = stays or remains
        if stays:
            copy(line[side, HEAD:], waiting[side])
        elif not remains:
            clear(waiting[side])


@kernel
def send_mailbox(k, at_ns, sent, message, line_sent, line):
    """Stamp a cell's messages with the time in the window at which they are sent."""
    for side in range(4):
        if sent[side]:
            line_sent[side] = True
            write_number(line[side], 0, 8, at_ns % k.window_ns)
            copy(message[side], line[side, HEAD:])
