"""Control period of one cell's board: hardware before and after the program's step.

One set of kernels serves all scenes: records of constants say which parts a board has, and messages are bytes.
"""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels import lines, watchdog
from cell_firmware.kernels.clock import due
from cell_firmware.kernels.jit import inlined, kernel
from cell_firmware.kernels.memory import address_of, call_at
from cell_firmware.kernels.messages import copy
from cell_firmware.kernels.speed_loop import drive_wheel

BOARD = np.dtype(
    [
        ("period_ns", "<i8"),
        ("window_ns", "<i8"),
        ("timeout_ns", "<i8"),
        ("reboot_ns", "<i8"),
        ("divider_ns", "<i8"),
        ("clock", "?"),
        ("watchdog", "?"),
        ("wheels", "?"),
        ("lines", "?"),
        ("meter", "?"),
    ],
    align=True,
)
"""Constants of a board: its times, and which parts it has."""

METER = np.dtype([("sent", "<i8"), ("received", "<i8"), ("neighbours", "u1", (4,))], align=True)
"""Counters of a cell's messages, and on which sides it has neighbours."""


@kernel
def window_of(k, tick):
    """The window in which the cells of an exchange read."""
    return tick - 1 if k.clock else tick


@kernel
def read_ns(k, clocks, i, window, now_ns):
    """Time at which a cell reads in a window, ns; -1: not in this one."""
    if not k.clock:
        return now_ns
    return due(k.period_ns, k.window_ns, clocks[i].ppb, clocks[i].phase_ns, window, clocks[i].count)


@inlined
def begin_cell(
    k, link, i, tick, now_ns, clocks, watches, cells, waiting, there_ns, there,
    line_received, line, received, message,
):  # fmt: skip
    """Begin a cell's tick: clock, lines, and watchdog.

    Args:
        k: Record of ``BOARD``.
        link: Record of ``LINES``.
        i: The cell's row in ``clocks`` to ``there``.
        tick: Of the exchange with the plant.
        now_ns: When all cells read; unless they have clocks of their own.
        clocks: ``(n,)`` of ``CLOCK``; none without clocks.
        watches: ``(n,)`` of ``WATCHDOG``; none without watchdogs.
        cells: ``(n,)`` of ``LINE``; none without lines, where messages are passed on whole.
        waiting: ``(n, 4, size)`` uint8, messages in mailboxes.
        there_ns: ``(n, slots, 4)``, when what lines carried arrives.
        there: ``(n, slots, 4, size)`` uint8, what they carried.
        line_received: ``(4,)``, whether the cell's lines carry something.
        line: ``(4, size)`` uint8, what they carry; of serial lines byte by byte its memory alone matters.
        received: ``(4,)``, all false; is filled with the messages for the program.
        message: ``(4, size)`` uint8, zeros; is filled.

    Returns:
        When the cell reads, whether its program runs, and whether its watchdog resets it before.
    """
    window = window_of(k, tick)
    at_ns = read_ns(k, clocks, i, window, now_ns)
    if k.lines:
        if link.kind == lines.SERIAL:
            lines.receive_serial(
                link, cells[i], there_ns[i], there[i], window, at_ns, line_received, line, received, message
            )
        elif link.kind == lines.MAILBOX:
            lines.receive_mailbox(link, cells[i], waiting[i], at_ns, line_received, line, received, message)
        else:
            call_at(
                link.receive,
                (
                    link.uarts, i, window, at_ns, address_of(line_received), address_of(line), address_of(received),
                    address_of(message),
                ),
            )  # fmt: skip
    runs, reset = at_ns >= 0, False
    if k.watchdog and runs:
        reset = watchdog.time_out(k, watches[i])
        runs = watchdog.runs(k, watches[i])
    return at_ns, runs, reset


@kernel
def count(meter, received, sent):
    """Count the messages of a cell: received ones, and sent ones for which there is a neighbour."""
    came, went = 0, 0
    for side in range(4):
        came += received[side]
        went += sent[side] and meter.neighbours[side] != 0
    meter.received += came
    meter.sent += went


@inlined
def end_cell(
    k, link, loop, i, tick, clocks, watches, wheels, cells, meters, waiting, going,
    at_ns, runs, received, speed_m_s, failed, served, sent, message, encoder_m, drive, line_sent, line,
):  # fmt: skip
    """End a cell's tick: speed loops, watchdog, meter, lines, and clock.

    Args:
        k: Record of ``BOARD``.
        link: Record of ``LINES``.
        loop: Record of ``LOOP``.
        i: The cell's row in ``clocks`` to ``going``.
        tick: Of the exchange with the plant.
        clocks: ``(n,)`` of ``CLOCK``; none without clocks.
        watches: ``(n,)`` of ``WATCHDOG``; none without watchdogs.
        wheels: ``(n,)`` of ``WHEELS``; none without motors.
        cells: ``(n,)`` of ``LINE``; none without lines, where messages are passed on whole.
        meters: ``(n,)`` of ``METER``; none where messages are not counted.
        waiting: ``(n, 4, size)`` uint8, messages that wait for a line.
        going: ``(n, 4, size)`` uint8, messages on a line.
        at_ns: As ``begin_cell`` returned it.
        runs: As ``begin_cell`` returned it.
        received: ``(4,)``, as ``begin_cell`` filled it.
        speed_m_s: ``(2,)``, the program's speed.
        failed: Whether the program failed.
        served: Whether it served its watchdog.
        sent: ``(4,)``, whether it sends.
        message: ``(4, size)`` uint8, its messages.
        encoder_m: ``(2,)``, travel of the wheels.
        drive: ``(2,)``; is filled.
        line_sent: ``(4,)``, all false; is filled.
        line: ``(4, size)`` uint8, zeros; is filled; as for ``begin_cell``.
    """
    window = window_of(k, tick)
    if runs:
        for axis in range(2):
            if not k.wheels:
                drive[axis] = speed_m_s[axis]
            else:
                drive[axis] = drive_wheel(loop, wheels[i], axis, speed_m_s[axis], encoder_m[axis])
            if failed:
                drive[axis] = 0.0
        if k.wheels:
            wheels[i].seen[0] = 1
        if k.meter:
            count(meters[i], received, sent)
        if k.lines:
            if link.kind == lines.SERIAL:
                lines.send_serial(
                    link, cells[i], waiting[i], going[i], window, at_ns, sent, message, line_sent, line
                )
            elif link.kind == lines.MAILBOX:
                lines.send_mailbox(link, at_ns, sent, message, line_sent, line)
            else:
                call_at(
                    link.send,
                    (
                        link.uarts, i, window, at_ns, address_of(sent), address_of(message), address_of(line_sent),
                        address_of(line),
                    ),
                )  # fmt: skip
    elif k.lines and link.kind == lines.BYTES and at_ns >= 0:
        call_at(link.idle, (link.uarts, i, at_ns))
    if k.watchdog and at_ns >= 0:
        if runs:
            watchdog.note(k, watches[i], drive, failed, served)
        else:
            copy(watches[i].drive, drive)
        watches[i].instants += 1
    if k.clock:
        if at_ns >= 0:
            copy(drive, clocks[i].drive)
            clocks[i].count += 1
        else:
            copy(clocks[i].drive, drive)
