"""Serial lines of one cell, byte by byte, as ``cell_firmware.effects.serial.lines`` defines them.

Programs' kernels call the three entry points by their addresses (``memory.call_at``): they are compiled once.
"""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels.clock import by_clock
from cell_firmware.kernels.jit import INTEGER, entry, inlined, kernel
from cell_firmware.kernels.lines import read_number, write_number
from cell_firmware.kernels.memory import array_at, move_memory

BITS = 10
"""Of a byte: start bit, eight of data, the least first, stop bit."""
STOP = BITS - 1
PADDING = 8
"""Bytes after a message and after a burst, which the general form needs to copy whole words."""
RUN_BYTES = 6
"""Bytes of a run's head in what a line carries: uint16, how many there are; uint32, when the first starts."""

UARTS = np.dtype(
    [
        (name, "<i8")
        for name in (
            "size",  # bytes of a message; a check byte follows them on the line
            "width",  # most bytes of a burst
            "bursts",  # that can be under way on a line
            "shifts",  # whether every window brings a burst, be it empty
            "polled",  # whether the driver polls the register
            "polled_bytes",  # that it sends in a period
            "room",  # bytes that can wait for the cell
            "dwell",  # periods that a shared SCI stays on a side; 0: a UART for each
            "behind",  # windows by which times on a line are counted from an earlier one than the cell's
            "window_ns",
            "period_ns",
            "byte_ns",  # by a clock without error
            "late_ns",  # how much later everything comes than it does on the line
            # addresses of arrays; n: cells
            "cells",  # (n,) of UART
            "runs",  # (n, 4, 2 bursts) of RUN: bytes under way, two runs a burst, the oldest first
            "samples",  # (n, 4, BITS): which bit a receiver reads as each, where clocks differ too much
            "going",  # (n, 4, size + 1 + PADDING) bytes: the message under way
            "waiting",  # (n, 4, size) bytes
            "buffer",  # (n, 4, size + 2 + width) bytes: what came of a message
            "data",  # (n, 4, bursts, width + PADDING) bytes under way
            "checks",  # (fields,) of CHECK
            "fields",  # how many numbers of a message can be no such number
        )
    ]
)
"""The lines of all cells of a shard: constants, and addresses of what stays in one place."""

RUN = np.dtype([("left", "<i8"), ("place", "<i8"), ("start_ns", "<i8")])
"""A run of bytes under way: how many are left, the place of the first in its burst, and when it starts."""

_LINE = (4,)
UART = np.dtype(
    [
        # in nearly every tick
        ("reaches", "u1", _LINE),
        ("waits", "u1", _LINE),
        ("skewed", "u1", _LINE),
        ("ppb", "<i8"),
        *(
            (name, "<i8", _LINE)
            for name in (
                "gone",
                "free_ns",
                "length",
                "last_ns",
                "sent",
                "replaced",
                "received",
                "byte_ns",
                "come_ns",
                "idle_ns",
                # on shared and disturbed lines
                "stop_ns",
                "overruns",
                "framing",
                "damaged",
                "unheard",
            )
        ),
        ("periods", "<i8"),
        ("ahead", "<i8"),
        ("since_ns", "<i8"),
    ],
    align=True,
)
"""State of a cell's lines by side, without bytes under way; names as in the state of ``SerialLines``."""

FLOAT, BOUNDED = 0, 1
CHECK = np.dtype([("kind", "<i8"), ("start", "<i8"), ("size", "<i8"), ("most", "<i8")])
"""A number of a message that not all bytes are: a float, which must be finite; or an unsigned number of ``most`` at
most, a truth value or the length of a list."""


@kernel
def check_of(data, size):
    """Check byte of the first ``size`` bytes, as ``framing.check_of``."""
    check = 0xFF
    for b in range(size):
        value = check ^ np.int64(data[b])
        over = value >> 7 ^ value >> 6
        check = (value ^ value << 1 ^ value << 2 ^ over ^ over << 1 ^ over << 2) & 0xFF
    return check


@kernel
def is_sound(k, data):
    """Whether bytes with their check byte are a message that a program can have sent; as ``Frame.unpack``."""
    if check_of(data, k.size) != data[k.size]:
        return False
    checks = array_at(k.checks, k.fields, CHECK)
    for c in range(k.fields):
        one = checks[c]
        value = read_number(data, one.start, one.size)
        if one.kind == FLOAT:
            fraction = 52 if one.size == 8 else 23 if one.size == 4 else 10
            exponents = (1 << (8 * one.size - 1 - fraction)) - 1
            if value >> fraction & exponents == exponents:
                return False
        elif value > one.most or value < 0:
            return False
    return True


@kernel
def close(k, cell, side, buffer, received, message):
    """End the bytes that came on a side as a message, or count a damaged one."""
    if cell.length[side] == k.size + 1 and is_sound(k, buffer):
        received[side] = True
        for b in range(k.size):
            message[side, b] = buffer[b]
    else:
        cell.damaged[side] += 1
    cell.length[side] = 0


@kernel
def pass_bytes(run, byte_ns, count):
    """Remove the first bytes of a run."""
    run.left -= count
    run.place += count
    run.start_ns += count * byte_ns


@kernel
def sampled(samples, value, followed):
    """Return the byte that the receiver samples, and whether it has a framing error; as ``timing.sampled``."""
    line = np.int64(value) << 1 | 1 << STOP | (0 if followed else 1 << BITS)
    read = 0
    for j in range(1, STOP):
        read |= (line >> samples[j] & 1) << (j - 1)
    return read, line >> samples[STOP] & 1 == 0


@kernel
def is_followed(runs, stop_ns, start_ns):
    """Whether the byte after one that began at a time has begun when its stop bit is sampled."""
    for r in range(len(runs)):
        later = runs[r].start_ns - start_ns
        if runs[r].left > 0 and later > 0 and later <= stop_ns:
            return True
    return False


@inlined
def queue(k, cell, runs, data, window, brings, line):
    """Queue the bursts that a cell's lines carried in the window before.

    Args:
        k: Record of ``UARTS``.
        cell: Record of ``UART``.
        runs: ``(4, 2 bursts)`` of ``RUN``.
        data: ``(4, bursts, width + PADDING)`` uint8.
        window: In which the cell's instants lie.
        brings: ``(4,)``, whether a line carried something.
        line: ``(4, bytes)`` uint8, what it carried.
    """
    begins_ns = (window - 1 - k.behind) * k.window_ns
    last = k.bursts - 1
    for side in range(4):
        if not (k.shifts or brings[side]):
            continue
        dropped = runs[side, 0].left + runs[side, 1].left
        if dropped:
            cell.overruns[side] += dropped
        move_memory(runs[side, 2:], runs[side, : 2 * last])
        move_memory(data[side, 1:], data[side, :last])
        # bytes beyond a window's room are dropped, whatever a sender claims
        first = min(read_number(line[side], 0, 2), k.width)
        one, other = runs[side, 2 * last], runs[side, 2 * last + 1]
        one.left, one.place = first, 0
        other.left, other.place = min(read_number(line[side], RUN_BYTES, 2), k.width - first), first
        one.start_ns = begins_ns + read_number(line[side], 2, 4)
        other.start_ns = begins_ns + read_number(line[side], RUN_BYTES + 2, 4)
        for b in range(k.width):
            data[side, last, b] = line[side, 2 * RUN_BYTES + b]
        for b in range(k.width, k.width + PADDING):
            data[side, last, b] = 0


@kernel
def keep(k, cell, side, buffer, value):
    """Append a byte to what came of a message."""
    cell.received[side] += 1
    buffer[cell.length[side]] = value
    cell.length[side] = min(cell.length[side] + 1, k.size + 2)


@inlined
def take(k, cell, side, runs, r, samples, at_ns, room, data, buffer, received, message):
    """Read the bytes of a run that have come.

    Args:
        k: Record of ``UARTS``.
        cell: Record of ``UART``.
        side: Of the line.
        runs: ``(2 bursts,)`` of ``RUN``, of the line.
        r: Which of them.
        samples: ``(BITS,)``, of the line.
        at_ns: When.
        room: How many bytes can wait for the cell, less those that were read.
        data: ``(width + PADDING,)`` uint8, of the run's burst.
        buffer: ``(bytes,)`` uint8, of the line.
        received: ``(4,)``; is filled.
        message: ``(4, size)`` uint8; is filled.

    Returns:
        How many came, and the room that is left.
    """
    run, byte_ns = runs[r], cell.byte_ns[side]
    left, start_ns = run.left, run.start_ns
    came = min(max((at_ns - cell.come_ns[side] - start_ns) // byte_ns + 1, 0), left)
    if came and k.dwell:
        lost = came
        if ((cell.periods - 1) // k.dwell + cell.ahead) % 4 == side:
            lost = min(max(-((start_ns + k.late_ns - cell.since_ns) // byte_ns), 0), came)
        cell.unheard[side] += lost
        pass_bytes(run, byte_ns, lost)
        came, left, start_ns = came - lost, left - lost, run.start_ns
    if not came:
        return 0, room
    if not k.polled:
        if start_ns - cell.last_ns[side] >= cell.idle_ns[side] and cell.length[side] > 0:
            close(k, cell, side, buffer, received, message)
        cell.last_ns[side] = start_ns + (came - 1) * byte_ns
    place, skewed = run.place, cell.skewed[side] != 0
    for j in range(came):
        value, fails = np.int64(data[place + j]), False
        if skewed:
            followed = left > j + 1 or is_followed(runs, cell.stop_ns[side], start_ns + j * byte_ns)
            value, fails = sampled(samples, value, followed)
        # an interrupt drops a byte with a framing error at once; in a polled register it takes up the room
        takes_room = k.polled or not fails
        if takes_room and room == 0:
            cell.overruns[side] += 1
            continue
        room -= takes_room
        if fails:
            cell.framing[side] += 1
        else:
            keep(k, cell, side, buffer, value)
    pass_bytes(run, byte_ns, came)
    return came, room


@inlined
def end_message(k, cell, side, runs, at_ns, silent, buffer, received, message):
    """End the message on a line whose end has been detected; ``silent``: no byte came in this period."""
    if cell.length[side] == 0:
        return
    if k.polled:
        if silent:
            close(k, cell, side, buffer, received, message)
        return
    idle_ns = cell.last_ns[side] + cell.idle_ns[side]
    if idle_ns + k.late_ns > at_ns:
        return
    for r in range(len(runs)):  # what has not come yet, but has begun
        if runs[r].left and runs[r].start_ns < idle_ns:
            return
    close(k, cell, side, buffer, received, message)


@entry(*[INTEGER] * 8)
def receive(uarts, i, window, at_ns, line_received, line, received, message):
    """One exchange of a cell's lines.

    Args:
        uarts: Address of a record of ``UARTS``; the next four are numbers, the others addresses too.
        i: The cell's row.
        window: In which the cell's instants lie.
        at_ns: When the cell reads; -1: it doesn't.
        line_received: ``(4,)`` bool, which lines carry something.
        line: ``(4, 2 RUN_BYTES + width)`` uint8, what they carry.
        received: ``(4,)`` bool, which sides have a message for the program; is filled.
        message: ``(4, size)`` uint8, zeros; is filled.

    Returns:
        0.
    """
    k = array_at(uarts, 1, UARTS)[0]
    cell = array_at(k.cells, i + 1, UART)[i]
    runs = array_at(k.runs, (i + 1, 4, 2 * k.bursts), RUN)[i]
    samples = array_at(k.samples, (i + 1, 4, BITS), np.int64)[i]
    buffer = array_at(k.buffer, (i + 1, 4, k.size + 2 + k.width), np.uint8)[i]
    data = array_at(k.data, (i + 1, 4, k.bursts, k.width + PADDING), np.uint8)[i]
    came = array_at(received, 4, np.bool_)
    words = array_at(message, (4, k.size), np.uint8)
    queue(
        k,
        cell,
        runs,
        data,
        window,
        array_at(line_received, 4, np.bool_),
        array_at(line, (4, 2 * RUN_BYTES + k.width), np.uint8),
    )
    for side in range(4):
        room, silent = k.room, at_ns >= 0
        for r in range(2 * k.bursts):
            if runs[side, r].left:  # seldom, and looking further takes time
                count, room = take(
                    k, cell, side, runs[side], r, samples[side], at_ns, room, data[side, r // 2], buffer[side],
                    came, words,
                )  # fmt: skip
                silent = silent and count == 0
        end_message(k, cell, side, runs[side], at_ns, silent, buffer[side], came, words)
    return 0


@kernel
def begins(k, cell, side, at_ns, next_ns, byte_ns, left):
    """Whether a waiting message begins.

    Args:
        k: Record of ``UARTS``.
        cell: Record of ``UART``.
        side: Of the line.
        at_ns: When the cell steps.
        next_ns: When it does next.
        byte_ns: How long a byte takes by its clock.
        left: Periods in which the message must be out; -1: there is time.
    """
    length = k.size + 1
    if not cell.waits[side] or cell.gone[side] != length:
        return False
    if cell.free_ns[side] >= (at_ns + 1 if k.polled else next_ns):
        return False
    if left < 0:
        return True
    if k.polled:
        return -(-length // k.polled_bytes) <= left
    return max(cell.free_ns[side], at_ns) + length * byte_ns <= at_ns + by_clock(left * k.period_ns, cell.ppb)


@inlined
def send_run(k, cell, side, at_ns, next_ns, byte_ns, going, there, line):
    """Continue the message under way until the cell steps again.

    Args:
        k: Record of ``UARTS``.
        cell: Record of ``UART``.
        side: Of the line.
        at_ns: When the cell steps.
        next_ns: When it does next.
        byte_ns: How long a byte takes by its clock.
        going: ``(bytes,)`` uint8, the message.
        there: Bytes that the line has already.
        line: ``(2 RUN_BYTES + width,)`` uint8, what the line carries; is filled.

    Returns:
        When the first of its bytes starts, and how many there are.
    """
    start_ns = max(cell.free_ns[side], at_ns)
    rest = k.size + 1 - cell.gone[side]
    if k.polled:
        count = min(rest, k.polled_bytes - there)
    else:
        count = max(min(rest, -((start_ns - next_ns) // byte_ns)), 0)
    if count <= 0:
        return start_ns, 0
    for b in range(count):
        line[2 * RUN_BYTES + there + b] = going[cell.gone[side] + b]
    free_ns = start_ns + count * byte_ns
    if count == rest:
        # a driver that polls is silent for half a period more, which leaves no doubt which step may begin the next one
        free_ns = at_ns + by_clock(3 * k.period_ns // 2, cell.ppb) if k.polled else free_ns + byte_ns
    cell.free_ns[side] = free_ns
    cell.gone[side] += count
    return start_ns, count


@kernel
def advance(k, cell, at_ns):
    """Begin the switch's next period; return the side that it is on, and for how many periods, this one counted."""
    period = cell.periods
    into = period % k.dwell
    if into == 0:
        cell.since_ns = at_ns
    cell.periods = period + 1
    return (period // k.dwell + cell.ahead) % 4, k.dwell - into


@entry(*[INTEGER] * 3)
def idle(uarts, i, at_ns):
    """Advance the switch in a period in which the program doesn't run; arguments as of ``receive``."""
    k = array_at(uarts, 1, UARTS)[0]
    if k.dwell:
        advance(k, array_at(k.cells, i + 1, UART)[i], at_ns)
    return 0


@entry(*[INTEGER] * 8)
def send(uarts, i, window, at_ns, sent, message, line_sent, line):
    """Send the bytes that start before a cell's next step.

    Args:
        uarts: Address of a record of ``UARTS``; the next four are numbers, the others addresses too.
        i: The cell's row.
        window: In which the cell's instants lie.
        at_ns: When the cell steps.
        sent: ``(4,)`` bool, to which sides the program sends.
        message: ``(4, size)`` uint8, its messages.
        line_sent: ``(4,)`` bool, all false; is filled.
        line: ``(4, 2 RUN_BYTES + width)`` uint8, zeros; is filled.

    Returns:
        0.
    """
    k = array_at(uarts, 1, UARTS)[0]
    cell = array_at(k.cells, i + 1, UART)[i]
    under_way = array_at(k.going, (i + 1, 4, k.size + 1 + PADDING), np.uint8)[i]
    waiting = array_at(k.waiting, (i + 1, 4, k.size), np.uint8)[i]
    sends, words = array_at(sent, 4, np.bool_), array_at(message, (4, k.size), np.uint8)
    carries, carried = (
        array_at(line_sent, 4, np.bool_),
        array_at(line, (4, 2 * RUN_BYTES + k.width), np.uint8),
    )
    next_ns, byte_ns = at_ns + by_clock(k.period_ns, cell.ppb), by_clock(k.byte_ns, cell.ppb)
    turned_to, periods = -1, -1
    if k.dwell:
        turned_to, periods = advance(k, cell, at_ns)
    for side in range(4):
        if sends[side]:
            if cell.reaches[side]:
                cell.replaced[side] += cell.waits[side]
                cell.waits[side] = 1
            for b in range(k.size):
                waiting[side, b] = words[side, b]
        going, out = under_way[side], carried[side]
        start_ns, there = send_run(k, cell, side, at_ns, next_ns, byte_ns, going, 0, out)
        if there:
            write_number(out, 0, 2, there)
            write_number(out, 2, 4, start_ns - (window - k.behind) * k.window_ns)
        left = -1
        if k.dwell:
            left = periods if side == turned_to else 0
        if begins(k, cell, side, at_ns, next_ns, byte_ns, left):
            for b in range(k.size):
                going[b] = waiting[side, b]
            going[k.size] = check_of(going, k.size)
            cell.gone[side] = 0
            cell.waits[side] = 0
            start_ns, count = send_run(k, cell, side, at_ns, next_ns, byte_ns, going, there, out)
            if count:
                write_number(out, RUN_BYTES, 2, count)
                write_number(out, RUN_BYTES + 2, 4, start_ns - (window - k.behind) * k.window_ns)
            there += count
        if there:
            carries[side] = True
            cell.sent[side] += there
    return 0
