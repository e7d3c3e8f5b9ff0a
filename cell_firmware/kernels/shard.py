"""A tick of all cells of a shard in one call: messages, sensors, boards, and programs in scalar form.

A cell is done with before the next one begins. Messages are read where the neighbours' steps of the tick before left
them, and written to a second place, which the next tick reads.
"""

from __future__ import annotations

from collections.abc import Callable
from types import FunctionType
from typing import Any

import numpy as np

from cell_firmware.kernels import lines
from cell_firmware.kernels.cell import BOARD, METER, begin_cell, count, end_cell, read_ns, window_of
from cell_firmware.kernels.clock import CLOCK, count_before, due
from cell_firmware.kernels.debounce import debounced
from cell_firmware.kernels.draws import draw_cell
from cell_firmware.kernels.jit import INTEGER, entry, inlined, kernel, read, written
from cell_firmware.kernels.memory import array_at, call_at, clear_memory, copy_memory, on_stack, part_of
from cell_firmware.kernels.program import MOST_SENSORS, inputs_type, outputs_type
from cell_firmware.kernels.speed_loop import LOOP, WHEELS
from cell_firmware.kernels.values import (
    clear_beyond,
    draft_words,
    first_misfit,
    is_whole_draft,
    list_records,
    round_draft,
    value_records,
)
from cell_firmware.kernels.watchdog import WATCHDOG, periods_left, times_out

LARGEST = np.finfo(np.float64).max
MOST_TICKS = np.int64(1) << 62

RESETS = -1
"""Result of a tick that was not begun, since a watchdog resets a cell in it."""

BOOL = np.dtype(np.bool_)
BYTE = np.dtype(np.uint8)
INT = np.dtype(np.int32)
LONG = np.dtype(np.int64)
DOUBLE = np.dtype(np.float64)
WORDS = np.dtype(np.uint64)

SHARD = np.dtype(
    [
        (name, "<i8")
        for name in (
            "cells",  # n of the shard, dead ones included
            "live",  # a of them that live
            "first",  # live cells from this one on, ...
            "last",  # ... before this one, are stepped
            "opens",  # whether watchdogs are looked at and dead cells silenced before
            "closes",  # whether messages are taken over the border then
            "sensors",  # of a cell
            "messages",  # whether there are any
            "slots",  # of a serial line's past
            "burst",  # bytes of what a serial line carries byte by byte; else 0
            "links_in",  # links over the border, into the shard
            "links_out",  # out of it
            "period_ns",  # of the exchanges
            "current",  # the outbox with the messages of the tick before; the other one is filled
            "debounce_ticks",  # 1: bits are taken as they are
            "clock_period_ns",  # of the clocks by which bits are read; 0: in every exchange
            "clock_window_ns",
            "bounces",  # counted
            "no_resets",  # ticks, the next one included, in which no watchdog can reset a cell
            # addresses of arrays; a tick reads ...
            "bits",  # (n, sensors) bool, presence
            "encoder_m",  # (n, 2), travel of the wheels; any numbers without motors
            "border_received",  # (links_in,) bool
            "border",  # (links_in, size + head or burst) bytes, messages over the border
            # ... and fills
            "drive",  # (n, 2), zeros for dead cells
            "border_sent",  # (links_out,) bool
            "border_out",  # (links_out, size + head or burst) bytes
            # the rest is its own
            "parameters",  # (1,), of the program
            "states",  # (a,), of the programs
            "boards",  # (1,) of BOARD
            "links",  # (1,) of LINES
            "loops",  # (1,) of LOOP
            "clocks",  # (a,) of CLOCK
            "watches",  # (a,) of WATCHDOG
            "wheels",  # (a,) of WHEELS
            "lines",  # (a,) of LINE
            "meters",  # (a,) of METER
            "waiting",  # (a, 4, size) bytes
            "going",  # (a, 4, size) bytes
            "there_ns",  # (a, slots, 4)
            "there",  # (a, slots, 4, size + head) bytes
            "rows",  # (a,) int32, ascending: the row of each live cell among the shard's
            "source",  # (n, 4) int32: slot of the outbox that a side reads; -1: none; below: border's link -2 - source
            "border_from",  # (links_out,): slot of the outbox
            "sent_0",  # (4 n,) bool, the two outboxes
            "sent_1",
            "outbox_0",  # (4 n, size + head or burst) bytes, zeros where nothing is sent
            "outbox_1",
            "random_keys",  # (names, 2) of WORDS
            "places",  # (a, 2): row and column of each live cell
            "line_brings",  # (4,) bool: whether lines bring a message to the program, ...
            "brought",  # ... and (4, size) bytes, these messages
            "line_takes",  # (4,) bool: whether the program sends a message by lines, ...
            "checked",  # (4, words) of 8 bytes, messages of a program that are looked at more closely
            "taken",  # ... and (4, size) bytes, these messages
            "line_received",  # (4,) bool
            "line",  # (4, size + head) bytes; or (4, burst)
            "failed",  # (a,) bool: whether a program drives what is no number, or sends what doesn't fit
            "speed",  # (a, 2): that speed; or two words of the draft, of the number that doesn't fit
            "misfit",  # (a,): side of the message times numbers of a message, plus place in it; -1: speed is no number
            "believed",  # (n, sensors) bool, of the debouncing
            "readings",  # (n, sensors)
            "ppb",  # (n,): errors of the clocks
            "phase_ns",  # (n,)
            "refuse",  # address of plausibility.refuse; 0: no message is refused
            "checks",  # (checks_count,) of CHECK
            "checks_count",
            "refused",  # (a,), messages refused by each cell
        )
    ]
)
"""A shard as ``run_tick`` has it: numbers, and addresses of what stays in one place."""


step: Any = None
PARAMETERS: Any = None
STATE: Any = None
INPUTS: Any = None
OUTPUTS: Any = None
SIZE: Any = None
RANDOM: Any = None
VALUES: Any = None
LISTS: Any = None
DRAFT: Any = None
WHOLE_DRAFT: Any = None
RANDOM_AT: Any = None
RECEIVED_AT: Any = None
MESSAGE_AT: Any = None
SENT_AT: Any = None
DRAFT_AT: Any = None
"""A program's step, its types, the bytes of its messages, how many random numbers it has, the numbers and lists of its
messages, the words of a draft, and places in its inputs and outputs: see ``compiled_program``."""


def run_rows(parameters, states, inputs, outputs):
    """Step the programs of cells alone.

    Args:
        parameters: One record.
        states: ``(n,)`` records, changed in place.
        inputs: ``(n,)`` of ``inputs_type``.
        outputs: ``(n,)`` of ``outputs_type``, as before a step; is filled.
    """
    for i in range(len(states)):
        step(parameters[0], states[i], inputs[i], outputs[i])


@kernel
def ticks_without_reset(k, s, window, now_ns, clocks, watches):
    """Ticks, this one included, before the first in which a watchdog can reset a cell; 0: one does in this tick.

    Being served only puts a watchdog off: until then neither clocks nor watchdogs are looked at.
    """
    ticks = MOST_TICKS
    for i in range(s.live):
        if read_ns(k, clocks, i, window, now_ns) >= 0 and times_out(k, watches[i]):
            return 0
        ticks = min(ticks, periods_left(k, watches[i]))
    return max(ticks, 1)


@inlined
def read_bits(s, row, window, bits, believed, readings):
    """Debounce a cell's presence bits.

    Args:
        s: Record of ``SHARD``, which counts bounces.
        row: Of the cell.
        window: In which it reads.
        bits: ``(n, sensors)``.
        believed: ``(n, sensors)``, the accepted bits, changed in place.
        readings: ``(n, sensors)``, readings in a row that differ from them, changed in place.
    """
    if s.clock_period_ns:
        ppb, phase_ns = (
            array_at(s.ppb, s.cells, LONG)[row],
            array_at(s.phase_ns, s.cells, LONG)[row],
        )
        before = count_before(s.clock_period_ns, ppb, phase_ns, window * s.clock_window_ns)
        if due(s.clock_period_ns, s.clock_window_ns, ppb, phase_ns, window, before) < 0:
            return
    for sensor in range(s.sensors):
        bit = bits[row, sensor]
        if bit == believed[row, sensor] and readings[row, sensor] > 0:
            s.bounces += 1
        believed[row, sensor], readings[row, sensor] = debounced(
            s.debounce_ticks, bit, believed[row, sensor], readings[row, sensor]
        )


@inlined
def collect_cell(row, source, sent, outbox, border_received, border, received, message):
    """Collect what a cell's links carry, from the last tick's outbox of the shard and from its border.

    Args:
        row: Of the cell.
        source: ``(n, 4)``, as in ``SHARD``.
        sent: ``(4 n,)``, and ...
        outbox: ... ``(4 n, size)`` uint8 of the shard.
        border_received: ``(l,)``, and ...
        border: ... ``(l, size)`` uint8 of the border.
        received: ``(4,)``; is filled.
        message: ``(4, size)`` uint8; is filled, with zeros where nothing came.
    """
    for side in range(4):
        slot = source[row, side]
        received[side] = False
        if slot >= 0 and sent[slot]:
            received[side] = True
            copy_memory(outbox[slot], message[side])
        elif slot < -1 and border_received[-2 - slot]:
            received[side] = True
            copy_memory(border[-2 - slot], message[side])
        else:
            clear_memory(message[side])


@kernel
def leave_shard(sent, outbox, border_from, border_sent, border):
    """Take the messages that leave a shard over its border."""
    for link in range(len(border_from)):
        row, side = border_from[link] // 4, border_from[link] % 4
        border_sent[link] = sent[row, side]
        if sent[row, side]:
            copy_memory(outbox[row, side], border[link])
        else:
            clear_memory(border[link])


@kernel
def silence(rows, drive, sent, outbox):
    """Have dead cells drive and send nothing.

    Args:
        rows: ``(a,)``, of the live cells, ascending.
        drive: ``(n, 2)``.
        sent: ``(n, 4)``.
        outbox: ``(n, 4, size)`` uint8.
    """
    i = 0
    for row in range(len(drive)):
        if i < len(rows) and rows[i] == row:
            i += 1
            continue
        drive[row, 0] = drive[row, 1] = 0.0
        for side in range(4):
            if sent[row, side]:
                sent[row, side] = False
                clear_memory(outbox[row, side])


@kernel
def is_finite(draft):
    """Whether all words of a cell's draft are numbers, ``(4, words)`` of float64."""
    finite = True
    for side in range(draft.shape[0]):
        for word in range(draft.shape[1]):
            finite &= abs(draft[side, word]) <= LARGEST
    return finite


@kernel
def first_wrong(values, says, draft, words):
    """Return the first number of a cell's messages that doesn't fit its field; -1: all fit.

    Args:
        values: ``(w,)`` of ``VALUE``.
        says: ``(4,)``, to which sides there is a message.
        draft: ``(4, words)`` of float64.
        words: ``(2,)``; is filled with that number's words.

    Returns:
        Side of the message times ``w``, plus place in it.
    """
    for side in range(4):
        if says[side]:
            place = first_misfit(values, draft[side])
            if place >= 0:
                word = values[place].word
                words[0], words[1] = draft[side, word], draft[side, min(word + 1, draft.shape[1] - 1)]
                return side * len(values) + place
    return -1


def run_tick(tick, shards):
    """Step live cells of a shard, from ``first`` on, before ``last``.

    Args:
        tick: Of the exchange with the plant.
        shards: One record of ``SHARD``.

    Returns:
        How many programs drive what is no number or send what doesn't fit, or ``RESETS`` if nothing was done; and how
        many bounces of presence bits were counted.
    """
    s = shards[0]
    n, live = s.cells, s.live
    k, link, loop = (
        array_at(s.boards, 1, BOARD)[0],
        array_at(s.links, 1, lines.LINES)[0],
        array_at(s.loops, 1, LOOP)[0],
    )
    clocks, watches = array_at(s.clocks, live, CLOCK), array_at(s.watches, live, WATCHDOG)
    window = window_of(k, tick)
    now_ns, bounces = tick * s.period_ns, s.bounces
    if s.opens and k.watchdog:
        if s.no_resets == 0:
            s.no_resets = ticks_without_reset(k, s, window, now_ns, clocks, watches)
            if s.no_resets == 0:
                return RESETS, 0
        s.no_resets -= 1
    wheels, meters = array_at(s.wheels, live, WHEELS), array_at(s.meters, live, METER)
    cells = array_at(s.lines, live, lines.LINE)
    waiting, going = array_at(s.waiting, (live, 4, SIZE), BYTE), array_at(s.going, (live, 4, SIZE), BYTE)
    there_ns = array_at(s.there_ns, (live, s.slots, 4), LONG)
    there = array_at(s.there, (live, s.slots, 4, SIZE + lines.HEAD), BYTE)
    rows, source = array_at(s.rows, live, INT), array_at(s.source, (n, 4), INT)
    parameters, states = array_at(s.parameters, 1, PARAMETERS), array_at(s.states, live, STATE)
    bits, encoder_m = array_at(s.bits, (n, s.sensors), BOOL), array_at(s.encoder_m, (n, 2), DOUBLE)
    drive, current = array_at(s.drive, (n, 2), DOUBLE), s.current
    border_received, links_out = array_at(s.border_received, s.links_in, BOOL), s.links_out
    border_sent, border_from = (
        array_at(s.border_sent, links_out, BOOL),
        array_at(s.border_from, links_out, LONG),
    )
    sent = array_at(s.sent_1 if current else s.sent_0, 4 * n, BOOL)
    sent_next = array_at(s.sent_0 if current else s.sent_1, (n, 4), BOOL)
    before, after = s.outbox_1 if current else s.outbox_0, s.outbox_0 if current else s.outbox_1
    every_input, every_output = on_stack(INPUTS), on_stack(OUTPUTS)
    clear_memory(every_input)
    inputs, outputs = every_input[0], every_output[0]
    inputs.sensors = s.sensors
    received = part_of(every_input, RECEIVED_AT, 4, BOOL)
    message = part_of(every_input, MESSAGE_AT, (4, SIZE), BYTE)
    says = part_of(every_output, SENT_AT, 4, BOOL)
    draft, draft_bits = (
        part_of(every_output, DRAFT_AT, (4, DRAFT), DOUBLE),
        part_of(every_output, DRAFT_AT, (4, DRAFT), LONG),
    )
    line_brings, brought = array_at(s.line_brings, 4, BOOL), array_at(s.brought, (4, SIZE), BYTE)
    checked = array_at(s.checked, (4, DRAFT), DOUBLE)
    line_takes, taken = array_at(s.line_takes, 4, BOOL), array_at(s.taken, (4, SIZE), BYTE)
    line_received, line = array_at(s.line_received, 4, BOOL), array_at(s.line, (4, SIZE + lines.HEAD), BYTE)
    failed, speed = array_at(s.failed, live, BOOL), array_at(s.speed, (live, 2), DOUBLE)
    misfit = array_at(s.misfit, live, LONG)
    believed = array_at(s.believed, (n, s.sensors), BOOL)
    readings = array_at(s.readings, (n, s.sensors), LONG)
    if RANDOM:  # a constant to the compiler
        random = part_of(every_input, RANDOM_AT, RANDOM, DOUBLE)
        keys = array_at(s.random_keys, (RANDOM, 2), WORDS)
        places = array_at(s.places, (live, 2), LONG)
    # what links carry: lines put a head before a message; the sizes are constants to the compiler
    lined, lined_next = (
        array_at(before, (4 * n, SIZE + lines.HEAD), BYTE),
        array_at(after, (n, 4, SIZE + lines.HEAD), BYTE),
    )
    whole, whole_next = array_at(before, (4 * n, SIZE), BYTE), array_at(after, (n, 4, SIZE), BYTE)
    lined_border = array_at(s.border, (s.links_in, SIZE + lines.HEAD), BYTE)
    whole_border = array_at(s.border, (s.links_in, SIZE), BYTE)
    byte_wise, burst = k.lines and link.kind == lines.BYTES, s.burst
    bursts, bursts_next = array_at(before, (4 * n, burst), BYTE), array_at(after, (n, 4, burst), BYTE)
    burst_border = array_at(s.border, (s.links_in, burst), BYTE)
    # numbers of records are read here: after every write to an array the compiler would read them again
    messages, metered, has_lines, sensors = s.messages != 0, k.meter, k.lines, s.sensors
    debounces = s.debounce_ticks != 1
    refuses = s.refuse != 0
    # a behavioural cell has none of these parts
    begins = k.clock or k.watchdog or has_lines
    ends = begins or k.wheels
    failures = 0
    if s.opens and live < n:
        size = burst if byte_wise else SIZE + lines.HEAD if has_lines else SIZE
        silence(rows, drive, sent_next, array_at(after, (n, 4, size), BYTE))
    for i in range(s.first, s.last):
        row = rows[i]
        if debounces:
            read_bits(s, row, window, bits, believed, readings)
        for sensor in range(MOST_SENSORS):
            if sensor < sensors:
                inputs.presence[sensor] = believed[row, sensor] if debounces else bits[row, sensor]
        if has_lines:
            if byte_wise:
                came = array_at(s.line, (4, burst), BYTE)
                collect_cell(row, source, sent, bursts, border_received, burst_border, line_received, came)
            else:
                collect_cell(row, source, sent, lined, border_received, lined_border, line_received, line)
            for side in range(4):
                line_brings[side] = False
                clear_memory(brought[side])
        elif messages:
            collect_cell(row, source, sent, whole, border_received, whole_border, received, message)
        at_ns, runs = now_ns, True
        if begins:
            at_ns, runs, _ = begin_cell(
                k, link, i, tick, now_ns, clocks, watches, cells, waiting, there_ns, there,
                line_received, line, line_brings, brought,
            )  # fmt: skip
        if refuses:
            if not has_lines:
                for side in range(4):
                    line_brings[side] = received[side]
                    copy_memory(message[side], brought[side])
            array_at(s.refused, live, LONG)[i] += call_at(
                s.refuse, (s.checks, s.checks_count, s.line_brings, s.brought, SIZE)
            )
        if has_lines or refuses:
            for side in range(4):
                received[side] = line_brings[side]
                copy_memory(brought[side], message[side])
        for side in range(4):
            says[side] = False
            clear_memory(draft_bits[side])
        wanted = outputs.speed_m_s
        wanted[0] = wanted[1] = 0.0
        outputs.served = 1
        fails = False
        if runs:
            if RANDOM:
                draw_cell(keys, window + 1, places[i], random)
            step(parameters[0], states[i], inputs, outputs)
            finite, wrong = np.isfinite(wanted[0]) and np.isfinite(wanted[1]), -1
            if WHOLE_DRAFT:  # a constant to the compiler
                if messages and finite and not is_finite(draft):
                    for side in range(4):
                        line_takes[side] = says[side]
                        for word in range(DRAFT):
                            checked[side, word] = draft[side, word]
                    wrong = first_wrong(VALUES, line_takes, checked, speed[i])
            elif messages and finite:
                for side in range(4):
                    if says[side]:
                        clear_beyond(LISTS, draft[side])
                wrong = first_wrong(VALUES, says, draft, speed[i])
            if wrong >= 0 or not finite:
                fails = True
                misfit[i] = wrong
                failures += 1
                for axis in range(2):
                    if wrong < 0:
                        speed[i, axis] = wanted[axis]
                    wanted[axis] = wanted[axis] if np.isfinite(wanted[axis]) else 0.0
                for side in range(4):
                    says[side] = False
        failed[i] = fails
        if messages:
            for side in range(4):
                had = sent_next[row, side]  # what has no message is zeros already, and isn't written
                sent_next[row, side] = says[side] and not has_lines
                target = whole_next[row, side]
                if has_lines:
                    target = taken[side]
                if not says[side]:
                    if had or has_lines:
                        clear_memory(target)
                elif WHOLE_DRAFT:  # a constant to the compiler
                    copy_memory(draft[side], target)
                else:
                    round_draft(VALUES, draft[side], draft_bits[side], target)
                if had and byte_wise:
                    clear_memory(bursts_next[row, side])
                elif had and has_lines:
                    clear_memory(lined_next[row, side])
        if ends:
            out = lined_next[row]
            if byte_wise:
                out = array_at(after + 4 * row * burst, (4, SIZE + lines.HEAD), BYTE)
            for side in range(4):
                line_takes[side] = says[side]
            end_cell(
                k, link, loop, i, tick, clocks, watches, wheels, cells, meters, waiting, going,
                at_ns, runs, received, wanted, fails, outputs.served != 0, line_takes, taken, encoder_m[row],
                drive[row], sent_next[row], out,
            )  # fmt: skip
        else:
            for axis in range(2):
                drive[row, axis] = 0.0 if fails else wanted[axis]
            if metered:
                count(meters[i], received, says)
    if s.closes and byte_wise:
        leave_shard(
            sent_next, bursts_next, border_from, border_sent, array_at(s.border_out, (links_out, burst), BYTE)
        )
    elif s.closes and has_lines:
        lined_out = array_at(s.border_out, (links_out, SIZE + lines.HEAD), BYTE)
        leave_shard(sent_next, lined_next, border_from, border_sent, lined_out)
    elif s.closes and messages:
        whole_out = array_at(s.border_out, (links_out, SIZE), BYTE)
        leave_shard(sent_next, whole_next, border_from, border_sent, whole_out)
    s.current = 1 - current
    return failures, s.bounces - bounces


def compiled_program(
    module: str,
    step: Callable[..., None],
    parameters: np.dtype[Any],
    state: np.dtype[Any],
    message: np.dtype[Any],
    random: tuple[str, ...] = (),
) -> tuple[Any, Any]:
    """Compile ``run_tick`` and ``run_rows`` for a program, or load them from disk.

    Args:
        module: Name of the program's module of kernels.
        step: Kernel of one cell, ``step(parameters, state, inputs, outputs)``.
        parameters: Type of the record of its constants.
        state: Type of the record of a cell's state.
        message: Type of its messages.
        random: Names of its random numbers.

    Returns:
        Both entry points.
    """
    inputs, outputs = inputs_type(message, random), outputs_type(message)
    names = {
        "step": step,
        "PARAMETERS": parameters,
        "STATE": state,
        "INPUTS": inputs,
        "OUTPUTS": outputs,
        "SIZE": message.itemsize,
        "RANDOM": len(random),
        "VALUES": value_records(message),
        "LISTS": list_records(message),
        "DRAFT": draft_words(message),
        "WHOLE_DRAFT": is_whole_draft(message),
        **_places(inputs, outputs),
    }
    tick = entry(INTEGER, written(SHARD, 1))(_for_program(run_tick, module, names))
    rows = entry(read(parameters, 1), written(state, 1), written(inputs, 1), written(outputs, 1))(
        _for_program(run_rows, module, names)
    )
    return tick, rows


def _places(inputs: np.dtype[Any], outputs: np.dtype[Any]) -> dict[str, int]:
    """Return the bytes at which parts of a step's inputs and outputs begin, by their names in ``run_tick``."""
    where = {
        "RANDOM_AT": (inputs, "random"),
        "RECEIVED_AT": (inputs, "received"),
        "MESSAGE_AT": (inputs, "message"),
        "SENT_AT": (outputs, "sent"),
        "DRAFT_AT": (outputs, "message"),
    }
    return {
        name: kind.fields[part][1]
        for name, (kind, part) in where.items()
        if kind.fields and part in kind.fields
    }


def _for_program(function: Any, module: str, names: dict[str, Any]) -> Any:
    """Return a function of this module as a program's own, in which the names of its step and types are bound.

    As arguments they would keep numba from caching what calls it.
    """
    made = FunctionType(function.__code__, {**globals(), **names}, function.__name__)
    made.__module__ = module
    # numba's cache tells functions of one file apart by this name
    made.__qualname__ = f"{module.rpartition('.')[2]}.{function.__name__}"
    return made
