"""What a cell's firmware finds when it looks at its lines: bytes in the order in which they came, and messages."""

from __future__ import annotations

from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.firmware import Bools, State
from cell_firmware.serial.frames import Bytes, Frame
from cell_firmware.serial.sampling import sampled
from cell_firmware.serial.settings import Ints, LineSettings
from cell_firmware.serial.times import LineTimes
from cell_firmware.serial.words import copy_bytes

COUNTERS: Final = ("received", "overruns", "framing", "damaged", "unheard")
"""What a look counts, of each line."""


@final
class Look:
    """One look at the lines of n cells; arrays are ``(n, 4)`` where nothing else is said.

    Args:
        settings: Of the lines.
        frame: Of the messages.
        times: Of the lines.
        runs: How many runs of bytes the state keeps a line.
        state: Of n cells.
        at_ns: ``(n, 1)`` or ``(1,)``, when; negative for a cell that doesn't.

    Attributes:
        after: What becomes of the state.
        whole: Where a message has come.
        message: The messages; zero elsewhere.
    """

    def __init__(
        self,
        settings: LineSettings,
        frame: Frame,
        times: LineTimes,
        runs: int,
        state: State,
        at_ns: Ints,
    ) -> None:
        shape = state["length"].shape
        self._settings, self._frame, self._times, self._runs = settings, frame, times, runs
        self._at_ns = at_ns
        self._skewed: Bools | None = times.skewed
        self._room = np.full(shape, settings.room)
        self._silent: Bools = np.broadcast_to(at_ns >= 0, shape)
        self.after: dict[str, Any] = {**state, "heard": state["heard"].copy()}
        self.whole = np.zeros(shape, dtype=np.bool_)
        self.message = np.zeros(shape, dtype=frame.message)

    def take(self, run: int, connected: Bools | None, since_ns: Ints | None) -> None:
        """The bytes of a run that have come.

        Args:
            run: Which: the oldest is 0.
            connected: Lines that have been through to the cell; None: all.
            since_ns: ``(n, 1)``, since when.
        """
        after, byte_ns = self.after, self._times.byte_ns
        left: Ints = after[f"left_{run}"]
        start: Ints = after[f"start_{run}_ns"]
        if not left.any():
            return
        came = np.minimum(np.maximum((self._at_ns - self._times.come_ns - start) // byte_ns + 1, 0), left)
        if not came.any():
            return
        if connected is not None and since_ns is not None:
            first = -((start + self._times.late_ns - since_ns) // byte_ns)
            lost = np.where(connected, np.minimum(np.maximum(first, 0), came), came)
            after["unheard"] = after["unheard"] + lost
            self._pass(run, lost)
            came, start = came - lost, after[f"start_{run}_ns"]
        if not self._settings.polled:
            self._ends_before(start, came)
            last = start + (came - 1) * byte_ns
            after["last_ns"] = np.where(came > 0, last, after["last_ns"])
        self._silent = self._silent & (came == 0)
        if self._skewed is not None and (odd := np.flatnonzero(self._skewed & (came > 0))).size:
            self._take_one_by_one(run, odd, came)
            self._take_all(run, np.where(self._skewed, 0, came))
        else:
            self._take_all(run, came)
        self._pass(run, came)

    def _ends_before(self, start: Ints, came: Ints) -> None:
        """Closes messages that an idle character before these bytes has ended."""
        idle = start - self.after["last_ns"] >= self._times.idle_ns
        self._close(np.flatnonzero(idle & (came > 0) & (self.after["length"] > 0)))

    def _pass(self, run: int, count: Ints) -> None:
        """So many bytes of a run are done with."""
        after = self.after
        after[f"left_{run}"] = after[f"left_{run}"] - count
        after[f"place_{run}"] = after[f"place_{run}"] + count
        after[f"start_{run}_ns"] = after[f"start_{run}_ns"] + count * self._times.byte_ns

    def _take_all(self, run: int, came: Ints) -> None:
        """Bytes that are read as they were sent: they wait for the firmware as far as there is room."""
        after = self.after
        kept = np.minimum(came, self._room)
        self._room = self._room - kept
        after["overruns"] = after["overruns"] + (came - kept)
        after["received"] = after["received"] + kept
        copy_bytes(
            _lines(after[f"data_{run // 2}"]),
            after[f"place_{run}"].reshape(-1),
            _lines(after["heard"]),
            after["length"].reshape(-1),
            kept.reshape(-1),
        )
        after["length"] = np.minimum(after["length"] + kept, self._frame.length + 1)

    def _take_one_by_one(self, run: int, line: Ints, came: Ints) -> None:
        """Bytes on lines whose clocks are so far apart that samples miss their bits."""
        after, count = self.after, came.reshape(-1)[line]
        place, start = after[f"place_{run}"].reshape(-1)[line], after[f"start_{run}_ns"].reshape(-1)[line]
        assert self._times.samples is not None, "this is a bug: no samples, but clocks that are off"
        samples = _lines(self._times.samples)[line]
        data, left = _lines(after[f"data_{run // 2}"]), after[f"left_{run}"].reshape(-1)[line]
        byte_ns = np.broadcast_to(self._times.byte_ns, came.shape).reshape(-1)[line]
        for name in ("overruns", "framing", "received", "length"):
            after[name] = after[name].copy()
        for i in range(int(count.max())):
            now = count > i
            followed = (left > i + 1) | self._followed(line, start + i * byte_ns)
            value, fails = sampled(data[line[now], place[now] + i], samples[now], followed[now])
            self._keep(line[now], value, fails)

    def _followed(self, line: Ints, start: Ints) -> Bools:
        """Whether the next byte on these lines has started when the stop bit of one that began then is sampled."""
        found, stop_ns = (
            np.zeros(len(line), dtype=np.bool_),
            np.broadcast_to(self._times.stop_ns, self.whole.shape).reshape(-1)[line],
        )
        for run in range(self._runs):
            later = self.after[f"start_{run}_ns"].reshape(-1)[line] - start
            found |= (self.after[f"left_{run}"].reshape(-1)[line] > 0) & (later > 0) & (later <= stop_ns)
        return found

    def _keep(self, line: Ints, value: Bytes, fails: Bools) -> None:
        """Puts a byte each where it waits for the firmware, if there is room, and in its message's place.

        An interrupt drops a byte with a framing error at once; in a register that is polled it takes up the room.
        """
        room = self._room.reshape(-1)
        takes_room = np.ones(len(line), dtype=np.bool_) if self._settings.polled else ~fails
        full = takes_room & (room[line] == 0)
        self._count("overruns", line[full])
        self._count("framing", line[fails & ~full])
        room[line[takes_room & ~full]] -= 1
        kept = ~fails & ~full
        line, value = line[kept], value[kept]
        self._count("received", line)
        length = self.after["length"].reshape(-1)
        _lines(self.after["heard"])[line, length[line]] = value
        length[line] = np.minimum(length[line] + 1, self._frame.length + 1)

    def end(self) -> None:
        """Closes the messages whose end has been seen."""
        after, times = self.after, self._times
        if self._settings.polled:
            self._close(np.flatnonzero(self._silent & (after["length"] > 0)))
            return
        idle = after["last_ns"] + times.idle_ns
        over = (after["length"] > 0) & (idle + times.late_ns <= self._at_ns)
        if not over.any():
            return
        for run in range(self._runs):  # what has not come yet, but has begun
            over &= (after[f"left_{run}"] == 0) | (after[f"start_{run}_ns"] >= idle)
        self._close(np.flatnonzero(over))

    def _close(self, line: Ints) -> None:
        """What has come on these lines since the last end is a message, or damaged."""
        if not len(line):
            return
        length = self.after["length"].reshape(-1)
        good = length[line] == self._frame.length
        checked, message = self._frame.unpack(_lines(self.after["heard"])[line[good]])
        whole = line[good][checked]
        self.whole.reshape(-1)[whole] = True
        self.message.reshape(-1)[whole] = message[checked]
        good[good] = checked
        self.after["damaged"] = self.after["damaged"].copy()
        self._count("damaged", line[~good])
        self.after["length"] = self.after["length"].copy()
        self.after["length"].reshape(-1)[line] = 0

    def _count(self, name: str, line: Ints) -> None:
        """Once more on each of these lines; the counter must not be the state's."""
        self.after[name].reshape(-1)[line] += 1


def _lines(array: NDArray[Any]) -> NDArray[Any]:
    """A row a line instead of a row a cell."""
    return array.reshape(-1, *array.shape[2:])
