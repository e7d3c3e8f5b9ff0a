"""One line, from the cell to its west: bursts by hand into the part, and the same line bit by bit in plain Python."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bus.lattice import Lattice
from cell_firmware.controller import StepTime
from cell_firmware.effects.serial.bursts import BurstType
from cell_firmware.effects.serial.lines import SerialLines
from cell_firmware.effects.serial.timing import LineSettings
from cell_firmware.firmware import Cells, Inbox, Outbox
from tests.cell_firmware.conftest import cells_of

PERIOD_NS = 4_096_000
BIT_NS = 104_000
WEST = 3
ONE_BYTE = np.dtype([("a", "u1")])
Runs = Sequence[tuple[int, bytes]]
"""Of a tick: start of each run since the tick began, ns, and its bytes."""


def two_cells() -> Cells:
    return cells_of(Lattice([(0, 0), (0, 1)]))


def errors_of(sender_ppb: int, own_ppb: int) -> Any:
    """Of the clocks of cells 0,0 and 0,1; 0 elsewhere."""

    def errors(row: NDArray[np.int64], column: NDArray[np.int64]) -> NDArray[np.int64]:
        return np.where(row != 0, 0, np.where(column == 0, sender_ppb, np.where(column == 1, own_ppb, 0)))

    return errors


class ReceiverBench:
    """Cell 0,1's side of the line.

    Attributes:
        messages: What it receives, by tick; None for nothing.
    """

    def __init__(
        self, settings: LineSettings, message: np.dtype[Any], clocks: tuple[int, int] | None = None
    ) -> None:
        errors = None if clocks is None else errors_of(*clocks)
        self.part = SerialLines(settings, message, errors_of=errors)
        self._exchange = clocks is not None  # a window is exchanged when it is over
        self.state = self.part.init(two_cells())
        self.messages: list[Any] = []
        self._type = BurstType(settings.slots(message.itemsize + 1))

    def tick(self, tick: int, at_ns: int, runs: Runs) -> None:
        """What came of the tick before is queued; the cell reads at ``at_ns``, or not if that is negative."""
        lines = np.zeros((2, 4), dtype=self._type.parts)
        place = 0
        for number, (start, data) in enumerate(runs, 1):
            lines[f"start_{number}_ns"][1, WEST] = start
            lines[f"bytes_{number}"][1, WEST] = len(data)
            lines["byte"][1, WEST, place : place + len(data)] = list(data)
            place += len(data)
        received = np.zeros((2, 4), dtype=np.bool_)
        received[1, WEST] = place > 0
        now = StepTime(tick + self._exchange, np.array([at_ns, at_ns]))
        self.state, inbox = self.part.receive(now, self.state, Inbox(received, lines.view(self._type.wire)))
        self.messages.append(inbox.message[1, WEST].item() if inbox.received[1, WEST] else None)

    def counted(self, name: str) -> int:
        """Of its west side; all others must have counted nothing."""
        assert self.state[name].sum() == self.state[name][1, WEST]
        return int(self.state[name][1, WEST])


@dataclass
class Bits:
    """The line as levels in time, and a receiver that samples them: what ``ReceiverBench`` is held to.

    Attributes:
        starts: When each byte starts, ascending, and its value.
        sender_bit: Length of the sender's bits, ns.
        own_bit: Of the receiver's.
    """

    sender_bit: Fraction
    own_bit: Fraction
    starts: list[tuple[int, int]] = field(default_factory=list[tuple[int, int]])

    def level(self, time: Fraction) -> int:
        """The line at a time: it idles at 1; the byte that began last says what it is."""
        began = [byte for byte in self.starts if byte[0] <= time]
        if not began:
            return 1
        start, value = began[-1]
        bits = [0, *(value >> i & 1 for i in range(8)), 1]
        number = int((time - start) // self.sender_bit)
        return bits[number] if number < 10 else 1

    def read(self, start: int) -> tuple[int, bool]:
        """What the receiver makes of the byte that starts then, and whether its stop bit is one."""
        samples = [self.level(start + (j + Fraction(1, 2)) * self.own_bit) for j in range(10)]
        return sum(bit << i for i, bit in enumerate(samples[1:9])), samples[9] == 1


EAST = 1


class Pair:
    """Cells 0,0 and 0,1 and their lines; by default both step at every multiple of the period.

    Attributes:
        received: ``(tick, message)`` of cell 0,1.
        starts: When each byte that cell 0,0 sent east starts, and the byte.
        state: Of both.
    """

    def __init__(self, settings: LineSettings, message: np.dtype[Any]) -> None:
        self.part = SerialLines(settings, message)
        self.message = message
        self.state = self.part.init(two_cells())
        self.received: list[tuple[int, Any]] = []
        self.starts: list[tuple[int, int]] = []
        self._period_ns = settings.period_ns
        self._parts = BurstType(settings.slots(message.itemsize + 1)).parts
        self._lines = Inbox(np.zeros((2, 4), dtype=np.bool_), np.zeros((2, 4), dtype=self.part.line))
        self.tick = 0

    def step(self, say: Any = None, *, lose: bool = False, back: Any = None) -> None:
        """A period: cell 0,0 says ``say`` to the east, cell 0,1 ``back`` to the west; their bytes may get lost."""
        now = StepTime(self.tick, np.array(self.tick * self._period_ns))
        self.state, inbox = self.part.receive(now, self.state, self._lines)
        if inbox.received[1, WEST]:
            self.received.append((self.tick, inbox.message[1, WEST].item()))
        outbox = Outbox.empty(2, self.message)
        for cell, side, word in ((0, EAST, say), (1, WEST, back)):
            if word is not None:
                outbox.sent[cell, side] = True
                outbox.message[cell, side] = word
        self.state, out = self.part.send(now, self.state, outbox)
        received, lines = np.zeros((2, 4), dtype=np.bool_), np.zeros((2, 4), dtype=self.part.line)
        if not lose:
            received[1, WEST], received[0, EAST] = out.sent[0, EAST], out.sent[1, WEST]
            lines[1, WEST], lines[0, EAST] = out.message[0, EAST], out.message[1, WEST]
        self._lines = Inbox(received, lines)
        self._log(out.message.view(self._parts)[0, EAST])
        self.tick += 1

    def _log(self, burst: Any) -> None:
        done = 0
        for run in (1, 2):
            count, begins = (
                int(burst[f"bytes_{run}"]),
                self.tick * self._period_ns + int(burst[f"start_{run}_ns"]),
            )
            byte_ns = self.part.settings.byte_ns
            self.starts += [(begins + i * byte_ns, int(burst["byte"][done + i])) for i in range(count)]
            done += count

    def counted(self, name: str, cell: int = 1, side: int = WEST) -> int:
        return int(self.state[name][cell, side])
