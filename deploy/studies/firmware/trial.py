"""Trials of a program: all cells of an array in lockstep, without plant and bus, under random readings."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from typing import Any, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import OPPOSITE, SIDES, Lattice
from cell_firmware.board import Board
from cell_firmware.controller import read_only
from cell_firmware.errors import FirmwareFailed
from cell_firmware.firmware import Cells, Firmware, Inbox, Inputs, State
from cell_firmware.message_values import values_of
from cell_firmware.program_step import ProgramStep

_CHANGES = 0.1
"""Probability that a reading changes from one tick to the next."""
_LOST = 0.1
"""Probability that a message is lost."""
_EXITS = 4
"""Numbers of labels, 0 included."""


@final
@dataclass(frozen=True, slots=True)
class Setting:
    """Setting of a trial.

    Attributes:
        cells: Cells of the array.
        lattice: Lattice of the array.
        ticks: Number of ticks.
        seed: Seed of readings, losses and the program's random numbers.
        motors: Whether there are encoders.
        level: Whether sensors are analogue.
        label: Whether there are scanners.
    """

    cells: Cells
    lattice: Lattice
    ticks: int
    seed: int
    motors: bool = False
    level: bool = False
    label: bool = False


@final
@dataclass(frozen=True, slots=True)
class Trace:
    """Outputs of all cells in all ticks.

    Attributes:
        speed_m_s: ``(ticks, n, 2)``.
        sent: ``(ticks, n, 4)``; None without messages.
        message: ``(ticks, n, 4)`` of the message type; zero where none is sent.
        failures: Failures, in order of ticks and cells.
    """

    speed_m_s: NDArray[np.float64]
    sent: NDArray[np.bool_] | None
    message: NDArray[Any] | None
    failures: tuple[FirmwareFailed, ...]

    def digests(self) -> list[str]:
        """Return a digest of each tick."""
        return [
            sha256(b"".join(part[k].tobytes() for part in self._parts() if part is not None)).hexdigest()[:16]
            for k in range(len(self.speed_m_s))
        ]

    def _parts(self) -> tuple[NDArray[Any] | None, ...]:
        return self.speed_m_s + 0.0, self.sent, self.message

    def difference(
        self, other: Trace, cells: Sequence[tuple[int, int]], names: tuple[str, str]
    ) -> str | None:
        """Return the first difference to another trace, in words; None if there is none.

        Args:
            other: The other trace, of equal shape.
            cells: Row and column of each cell.
            names: Names of the two traces: "among 20 cells" and "alone".
        """
        found: list[tuple[int, int, str]] = []
        for what, a, b, parts in self._quantities(other):
            differ = a != b
            if differ.any():
                tick, cell, part = (int(i) for i in np.argwhere(differ)[0])
                values = [
                    f"{one[tick, cell, part].item()!r} {name}"
                    for one, name in zip((a, b), names, strict=True)
                ]
                where = f"tick {tick}, cell {cells[cell][0]},{cells[cell][1]}"
                found.append((tick, cell, f"{where}: {what} {parts[part]} is {values[0]}, and {values[1]}"))
        return min(found)[2] if found else None

    def _quantities(self, other: Trace) -> list[tuple[str, NDArray[Any], NDArray[Any], tuple[str, ...]]]:
        found: list[tuple[str, NDArray[Any], NDArray[Any], tuple[str, ...]]] = [
            ("speed along", self.speed_m_s, other.speed_m_s, ("x", "y"))
        ]
        if self.sent is not None and other.sent is not None:
            found.append(("a message sent to the", self.sent, other.sent, SIDES))
        if self.message is not None and other.message is not None:
            found += [
                (f"message field {value.name} to the", value.of(self.message), value.of(other.message), SIDES)
                for value in values_of(self.message.dtype)
            ]
        return found


Observer = Callable[[int, NDArray[np.int64], State, Inputs, ProgramStep], None]
"""Called after each step with tick, rows of the cells, the state before, the inputs, and the result."""


def run_trial(
    firmware: Firmware,
    setting: Setting,
    groups: Sequence[NDArray[np.int64]] | None = None,
    observe: Observer | None = None,
    each: Callable[[], Firmware] | None = None,
) -> Trace:
    """Step a program over an array.

    Args:
        firmware: The program.
        setting: The setting; its readings and losses depend on nothing else.
        groups: Rows of the cells that are stepped together; None: all of them.
        observe: Called after each step of a group.
        each: Loads the program for a group, as each process does; None: all groups have ``firmware``.

    Raises:
        FirmwareFailed: The program's ``init`` failed.
    """
    n, cells = len(setting.cells), setting.cells
    groups = [np.arange(n)] if groups is None else groups
    draw = np.random.default_rng(setting.seed)
    boards = [Board(each() if each else firmware, seed=setting.seed) for _ in groups]
    parts = [cells.select(rows) for rows in groups]
    states = [board.init(part).parts["firmware"] for board, part in zip(boards, parts, strict=True)]
    message = firmware.message
    trace = Trace(
        np.zeros((setting.ticks, n, 2)),
        None if message is None else np.zeros((setting.ticks, n, 4), dtype=np.bool_),
        None if message is None else np.zeros((setting.ticks, n, 4), dtype=message),
        (),
    )
    failures: list[FirmwareFailed] = []
    failed = np.zeros(n, dtype=np.bool_)
    presence = np.zeros((n, cells.sensors), dtype=np.bool_)
    encoder_m = np.zeros((n, 2))
    for tick in range(setting.ticks):
        presence = presence ^ (draw.random(presence.shape) < _CHANGES)
        lost = draw.random((n, 4)) < _LOST
        labels = draw.integers(0, _EXITS, n)
        inbox = _delivered(trace, tick, setting.lattice, lost)
        for g, rows in enumerate(groups):
            inputs = Inputs(
                presence[rows],
                encoder_m[rows] if setting.motors else None,
                None if inbox is None else Inbox(inbox.received[rows], inbox.message[rows]),
                presence[rows].astype(np.float64) if setting.level else None,
                labels[rows] if setting.label else None,
            )
            board = boards[g]
            if board.streams is not None:
                inputs = inputs.with_random(board.streams.of_tick(tick, parts[g].row, parts[g].column))
            done = board.step_program(tick, parts[g], states[g], inputs)
            if observe is not None:
                observe(tick, rows, states[g], inputs, done)
            states[g] = read_only(done.state)
            failures += [one for i, one in done.failures.items() if not failed[rows[i]]]
            failed[rows[list(done.failures)]] = True
            _store(trace, tick, rows, done, failed)
        encoder_m = encoder_m + cells.period_s * trace.speed_m_s[tick]
    return Trace(trace.speed_m_s, trace.sent, trace.message, tuple(failures))


def _store(
    trace: Trace, tick: int, rows: NDArray[np.int64], done: ProgramStep, failed: NDArray[np.bool_]
) -> None:
    good = ~failed[rows]
    trace.speed_m_s[tick, rows] = np.where(good[:, None], done.speed_m_s, 0.0)
    if done.outbox is not None and trace.sent is not None and trace.message is not None:
        sent = done.outbox.sent & good[:, None]
        trace.sent[tick, rows] = sent
        values = done.outbox.message.copy()
        values[~sent] = np.zeros((), dtype=values.dtype)
        trace.message[tick, rows] = values


def _delivered(trace: Trace, tick: int, lattice: Lattice, lost: NDArray[np.bool_]) -> Inbox | None:
    """Return the messages of the tick before, less lost ones."""
    if trace.sent is None or trace.message is None:
        return None
    received = np.zeros(trace.sent.shape[1:], dtype=np.bool_)
    message = np.zeros(received.shape, dtype=trace.message.dtype)
    if tick:
        for side in range(4):
            source = lattice.neighbours[:, side]
            there = (source >= 0) & ~lost[:, side]
            there[there] = trace.sent[tick - 1, source[there], OPPOSITE[side]]
            received[there, side] = True
            message[there, side] = trace.message[tick - 1, source[there], OPPOSITE[side]]
    return Inbox(received, message)
