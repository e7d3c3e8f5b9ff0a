"""The sending half of a cell's four lines."""

from __future__ import annotations

from typing import Any, final

import numpy as np

from cell_firmware.effects.serial.bursts import WORD, BurstType, copy_bytes
from cell_firmware.effects.serial.framing import Bytes, Frame, check_of
from cell_firmware.effects.serial.timing import Ints, LineSettings, by_clock
from cell_firmware.firmware import Bools, Cells, Outbox, State


@final
class Sender:
    """Sender of messages, byte by byte: one is in transmission, one waits, and a newer one replaces the waiting one.

    With interrupts the bytes of a message follow each other without a gap, and an idle character, ten bits of one, ends
    it. A driver that polls hands over so many bytes a period, and a period without ends the message.

    Args:
        settings: Of the lines.
        frame: Of the messages.
        burst: Of what a line carries in a window.
        window_ns: How long a window of the exchange is.
    """

    def __init__(self, settings: LineSettings, frame: Frame, burst: BurstType, window_ns: int) -> None:
        self._settings = settings
        self._frame = frame
        self._burst = burst
        self._window_ns = window_ns

    def init(self, cells: Cells) -> State:
        """Nothing to send."""
        lines = (len(cells), 4)
        return {
            "reaches": cells.has_neighbour.copy(),
            "going": np.zeros((*lines, self._frame.length + WORD), dtype=np.uint8),
            "gone": np.full(lines, self._frame.length, dtype=np.int64),  # all of it: nothing is under way
            "waiting": np.zeros((*lines, self._frame.size), dtype=np.uint8),
            "waits": np.zeros(lines, dtype=np.bool_),
            "free_ns": np.zeros(lines, dtype=np.int64),
            "sent": np.zeros(lines, dtype=np.int64),
            "replaced": np.zeros(lines, dtype=np.int64),
        }

    def step(
        self,
        window: int,
        at_ns: Ints,
        ppb: Ints | None,
        state: State,
        outbox: Outbox | None,
        left: Ints | None,
    ) -> tuple[State, Outbox]:
        """Send the bytes that start between this step of the cells and the next.

        Args:
            window: In which the cells' instants lie.
            at_ns: ``(n, 1)`` or ``(1,)``, when the cells step.
            ppb: ``(n, 1)``, their clocks' errors; None for none.
            state: Of n cells.
            outbox: Messages of the program; None if there are none at all.
            left: ``(n, 4)``, periods in which a message that begins now must be out; None: there is time.
        """
        going = _Going(self._settings, self._frame, at_ns, ppb, dict(state))
        after = going.after
        if outbox is not None:
            going.take(outbox)
        bursts = np.zeros(after["gone"].shape, dtype=self._burst.parts)
        data = np.zeros((after["gone"].size, bursts.dtype["byte"].shape[0] + WORD), dtype=np.uint8)
        there = np.zeros(after["gone"].shape, dtype=np.int64)
        for run in ("1", "2"):
            if run == "2" and not going.begin(left):
                break
            start, count = going.run(data, there)
            bursts[f"bytes_{run}"] = count
            bursts[f"start_{run}_ns"] = np.where(count > 0, start - window * self._window_ns, 0)
            there = there + count
        bursts["byte"] = data[:, :-WORD].reshape(*there.shape, -1)
        after["sent"] = after["sent"] + there
        return after, Outbox(there > 0, self._burst.to_wire(bursts))


@final
class _Going:
    """Transmission state of n cells during one period.

    Attributes:
        after: What becomes of their state.
    """

    def __init__(
        self, settings: LineSettings, frame: Frame, at_ns: Ints, ppb: Ints | None, after: dict[str, Any]
    ) -> None:
        self._settings = settings
        self._frame = frame
        self._at_ns = at_ns
        self._ppb = ppb
        self._next_ns = at_ns + by_clock(settings.period_ns, ppb)
        self._byte_ns = by_clock(settings.byte_ns, ppb)
        self.after = after

    def take(self, outbox: Outbox) -> None:
        """Queue the program's messages, which replace waiting ones."""
        after, sent = self.after, outbox.sent
        fresh = sent & after["reaches"]
        data = self._frame.pack(outbox.message)
        if not sent.all():
            data = np.where(sent[..., None], data, after["waiting"])
        after["replaced"] = after["replaced"] + (fresh & after["waits"])
        after["waiting"] = data
        after["waits"] = after["waits"] | fresh

    def begin(self, left: Ints | None) -> bool:
        """Begin waiting messages on free lines; return whether there are any."""
        length, size, after = self._frame.length, self._frame.size, self.after
        begins = after["waits"] & (after["gone"] == length)
        begins &= after["free_ns"] < (self._at_ns + 1 if self._settings.polled else self._next_ns)
        if left is not None:
            begins &= self._fits(left)
        lines = np.flatnonzero(begins)
        if not len(lines):
            return False
        data = after["waiting"].reshape(-1, size)[lines]
        going = after["going"].copy()
        flat = going.reshape(-1, going.shape[-1])
        flat[lines, :size] = data
        flat[lines, size] = check_of(data)
        after["going"] = going
        after["gone"] = np.where(begins, 0, after["gone"])
        after["waits"] = after["waits"] & ~begins
        return True

    def _fits(self, left: Ints) -> Bools:
        """Return where a message that begins now ends before the switch moves on."""
        settings, length = self._settings, self._frame.length
        if settings.polled:
            return settings.periods(length) <= left
        end = np.maximum(self.after["free_ns"], self._at_ns) + length * self._byte_ns
        return end <= self._at_ns + by_clock(left * settings.period_ns, self._ppb)

    def run(self, data: Bytes, there: Ints) -> tuple[Ints, Ints]:
        """Continue the messages in transmission until the cells step again.

        Args:
            data: ``(4 n, slots)``, where its bytes go.
            there: ``(n, 4)``, how many are there already.

        Returns:
            ``(n, 4)``: when the first of its bytes starts, and how many there are.
        """
        after, settings = self.after, self._settings
        start = np.maximum(after["free_ns"], self._at_ns)
        rest = self._frame.length - after["gone"]
        if settings.polled:
            count = np.minimum(rest, settings.polled_bytes - there)
        else:
            count = np.minimum(rest, -((start - self._next_ns) // self._byte_ns))
            count = np.maximum(count, 0)
        if not count.any():
            return start, count
        going = after["going"]
        frames = going.reshape(-1, going.shape[-1])
        gone, there = after["gone"].reshape(-1), there.reshape(-1)
        copy_bytes(
            frames, gone, data, there, count.reshape(-1), clean=True
        )  # a line gives nothing ahead of time
        free = np.where(count > 0, start + count * self._byte_ns, after["free_ns"])
        ended = (count > 0) & (count == rest)
        after["free_ns"] = np.where(ended, self._quiet(free), free)
        after["gone"] = after["gone"] + count
        return start, count

    def _quiet(self, free_ns: Ints) -> Ints:
        """Return the end of the silence after a message."""
        if self._settings.polled:
            # Half a period more than the silent one leaves no doubt which step may begin the next message.
            return self._at_ns + by_clock(3 * self._settings.period_ns // 2, self._ppb)
        return free_ns + self._byte_ns
