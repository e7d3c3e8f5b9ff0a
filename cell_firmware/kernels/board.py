"""The control period of the boards of a shard's cells, around a step of their programs in Python."""

from __future__ import annotations

from cell_firmware.kernels import lines, watchdog
from cell_firmware.kernels.cell import BOARD, METER, begin_cell, end_cell
from cell_firmware.kernels.clock import CLOCK
from cell_firmware.kernels.jit import INTEGER, entry, read, written
from cell_firmware.kernels.speed_loop import LOOP, WHEELS


@entry(
    INTEGER, INTEGER, read(BOARD, 1), read(lines.LINES, 1), read(CLOCK, 1), written(watchdog.WATCHDOG, 1),
    written(lines.LINE, 1), written("u1", 3), written("i8", 3), written("u1", 4), read("?", 2), read("u1", 3),
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
    there_ns,
    there,
    line_received,
    line,
    at_ns,
    runs,
    reset,
    received,
    message,
):
    """Begin a tick of all cells, as ``begin_cell`` does of one.

    Args:
        tick: Of the exchange with the plant.
        now_ns: When all cells read; unless they have clocks of their own.
        boards: One record of ``BOARD``.
        links: One record of ``LINES``.
        clocks: As of ``begin_cell``; and so are ``watches`` to ``there``.
        watches: ``(n,)``.
        cells: ``(n,)``.
        waiting: ``(n, 4, size)`` uint8.
        there_ns: ``(n, slots, 4)``.
        there: ``(n, slots, 4, size)`` uint8.
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
        at_ns[i], runs[i], reset[i] = begin_cell(
            k, link, i, tick, now_ns, clocks, watches, cells, waiting, there_ns, there,
            line_received[i], line[i], received[i], message[i],
        )  # fmt: skip
        running += runs[i]
        resets += reset[i]
    return running, resets


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
    """End a tick of all cells, as ``end_cell`` does of one.

    Args:
        tick: Of the exchange with the plant.
        boards: One record of ``BOARD``.
        links: One record of ``LINES``.
        loops: One record of ``LOOP``.
        clocks: As of ``end_cell``; and so are ``watches`` to ``going``.
        watches: ``(n,)``.
        wheels: ``(n,)``.
        cells: ``(n,)``.
        meters: ``(n,)``.
        waiting: ``(n, 4, size)`` uint8.
        going: ``(n, 4, size)`` uint8.
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
    for i in range(len(at_ns)):
        end_cell(
            k, link, loop, i, tick, clocks, watches, wheels, cells, meters, waiting, going,
            at_ns[i], runs[i], received[i], speed_m_s[i], failed[i], served[i], sent[i], message[i], encoder_m[i],
            drive[i], line_sent[i], line[i],
        )  # fmt: skip
