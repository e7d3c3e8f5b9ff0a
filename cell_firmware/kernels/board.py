"""The control period of the boards of a shard's cells: what comes before the programs' steps, and what comes after.

One set of kernels serves all scenes: records of constants say which parts a board has, and messages are bytes.
"""

from __future__ import annotations

import numpy as np

from cell_firmware.kernels import lines, watchdog
from cell_firmware.kernels.clock import CLOCK, due
from cell_firmware.kernels.jit import INTEGER, entry, kernel, read, written
from cell_firmware.kernels.messages import copy
from cell_firmware.kernels.speed_loop import LOOP, WHEELS, drive_wheel

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


@entry(
    INTEGER, INTEGER, read(BOARD, 1), read(lines.LINES, 1), read(CLOCK, 1), written(watchdog.WATCHDOG, 1),
    written(lines.LINE, 1), written("u1", 3), written("u1", 4), read("?", 2), read("u1", 3),
    written("i8", 1), written("?", 1), written("?", 1), written("?", 2), written("u1", 3),
)  # fmt: skip
def begin(
    tick,
    now_ns,
    boards,
    links,
    clocks,
    watches,
    cells,
    waiting,
    there,
    line_received,
    line,
    at_ns,
    runs,
    reset,
    received,
    message,
):
    """Begin a tick: clocks, lines, and watchdogs.

    Args:
        tick: Of the exchange with the plant.
        now_ns: When all cells read; unless they have clocks of their own.
        boards: One record of ``BOARD``.
        links: One record of ``LINES``.
        clocks: ``(n,)`` of ``CLOCK``; none without clocks.
        watches: ``(n,)`` of ``WATCHDOG``; none without watchdogs.
        cells: ``(n,)`` of ``LINE``; none without lines, where messages are passed on whole.
        waiting: ``(n, 4, size)`` uint8, messages in mailboxes.
        there: ``(n, slots, 4, size)`` uint8, what lines carried.
        line_received: ``(n, 4)``, whether a line carries something.
        line: ``(n, 4, size)`` uint8, what it carries.
        at_ns: ``(n,)``, is set to when each cell reads; -1: not in this exchange.
        runs: ``(n,)``, is set to whether its program runs.
        reset: ``(n,)``, is set to whether its watchdog resets it before.
        received: ``(n, 4)``, all false; is filled with the messages for the program.
        message: ``(n, 4, size)`` uint8, zeros; is filled.

    Returns:
        How many programs run, and how many cells are reset.
    """
    k, link = boards[0], links[0]
    running, resets = 0, 0
    for i in range(len(at_ns)):
        window = tick - 1 if k.clock else tick
        if k.clock:
            clock = clocks[i]
            at_ns[i] = due(k.period_ns, k.window_ns, clock.ppb, clock.phase_ns, window, clock.count)
        else:
            at_ns[i] = now_ns
        if k.lines:
            if link.kind == lines.SERIAL:
                lines.receive_serial(
                    link,
                    cells[i],
                    there[i],
                    window,
                    at_ns[i],
                    line_received[i],
                    line[i],
                    received[i],
                    message[i],
                )
            else:
                lines.receive_mailbox(
                    link, cells[i], waiting[i], at_ns[i], line_received[i], line[i], received[i], message[i]
                )
        reset[i] = False
        runs[i] = at_ns[i] >= 0
        if k.watchdog and runs[i]:
            reset[i] = watchdog.time_out(k, watches[i])
            runs[i] = watchdog.runs(k, watches[i])
        running += runs[i]
        resets += reset[i]
    return running, resets


@kernel
def count(meter, received, sent):
    """Count the messages of a cell: received ones, and sent ones for which there is a neighbour."""
    for side in range(4):
        meter.received += received[side]
        meter.sent += sent[side] and meter.neighbours[side] != 0


@entry(
    INTEGER, read(BOARD, 1), read(lines.LINES, 1), read(LOOP, 1), written(CLOCK, 1), written(watchdog.WATCHDOG, 1),
    written(WHEELS, 1), written(lines.LINE, 1), written(METER, 1), written("u1", 3), written("u1", 3),
    read("i8", 1), read("?", 1), read("?", 2), read("f8", 2), read("?", 1), read("?", 1), read("?", 2), read("u1", 3),
    read("f8", 2), written("f8", 2), written("?", 2), written("u1", 3),
)  # fmt: skip
def end(
    tick,
    boards,
    links,
    loops,
    clocks,
    watches,
    wheels,
    cells,
    meters,
    waiting,
    going,
    at_ns,
    runs,
    received,
    speed_m_s,
    failed,
    served,
    sent,
    message,
    encoder_m,
    drive,
    line_sent,
    line,
):
    """End a tick: speed loops, watchdogs, meters, lines, and clocks.

    Args:
        tick: Of the exchange with the plant.
        boards: One record of ``BOARD``.
        links: One record of ``LINES``.
        loops: One record of ``LOOP``.
        clocks: ``(n,)`` of ``CLOCK``; none without clocks.
        watches: ``(n,)`` of ``WATCHDOG``; none without watchdogs.
        wheels: ``(n,)`` of ``WHEELS``; none without motors.
        cells: ``(n,)`` of ``LINE``; none without lines, where messages are passed on whole.
        meters: ``(n,)`` of ``METER``; none where messages are not counted.
        waiting: ``(n, 4, size)`` uint8, messages that wait for a line.
        going: ``(n, 4, size)`` uint8, messages on a line.
        at_ns: ``(n,)``, as ``begin`` set it.
        runs: ``(n,)``, as ``begin`` set it.
        received: ``(n, 4)``, as ``begin`` filled it.
        speed_m_s: ``(n, 2)``, the programs' speeds.
        failed: ``(n,)``, whether a program failed.
        served: ``(n,)``, whether it served its watchdog.
        sent: ``(n, 4)``, whether it sends.
        message: ``(n, 4, size)`` uint8, its messages.
        encoder_m: ``(n, 2)``, travel of the wheels.
        drive: ``(n, 2)``, zeros; is filled.
        line_sent: ``(n, 4)``, all false; is filled.
        line: ``(n, 4, size)`` uint8, zeros; is filled.
    """
    k, link, loop = boards[0], links[0], loops[0]
    window = tick - 1 if k.clock else tick
    for i in range(len(at_ns)):
        if runs[i]:
            for axis in range(2):
                if not k.wheels:
                    drive[i, axis] = speed_m_s[i, axis]
                else:
                    drive[i, axis] = drive_wheel(
                        loop, wheels[i], axis, speed_m_s[i, axis], encoder_m[i, axis]
                    )
                if failed[i]:
                    drive[i, axis] = 0.0
            if k.wheels:
                wheels[i].seen[0] = 1
            if k.meter:
                count(meters[i], received[i], sent[i])
            if k.lines:
                if link.kind == lines.SERIAL:
                    lines.send_serial(
                        link,
                        cells[i],
                        waiting[i],
                        going[i],
                        window,
                        at_ns[i],
                        sent[i],
                        message[i],
                        line_sent[i],
                        line[i],
                    )
                else:
                    lines.send_mailbox(link, at_ns[i], sent[i], message[i], line_sent[i], line[i])
        if k.watchdog and at_ns[i] >= 0:
            if runs[i]:
                watchdog.note(k, watches[i], drive[i], failed[i], served[i])
            else:
                copy(watches[i].drive, drive[i])
            watches[i].instants += 1
        if k.clock:
            if at_ns[i] >= 0:
                copy(drive[i], clocks[i].drive)
                clocks[i].count += 1
            else:
                copy(clocks[i].drive, drive[i])
