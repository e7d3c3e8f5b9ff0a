"""Receiving half of a cell's four lines: bytes in order of arrival, and messages assembled from bytes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import STEPS
from cell_firmware.effects.serial.bursts import WORD, BurstType, copy_bytes
from cell_firmware.effects.serial.framing import Bytes, Frame
from cell_firmware.effects.serial.timing import Ints, LineSettings, LineTimes, sampled
from cell_firmware.firmware import Bools, Cells, Inbox, State

COUNTERS: Final = ("received", "overruns", "framing", "damaged", "unheard")
"""Counters of a read, of each line."""


@final
class UartReader:
    """Reading of the lines of n cells in one step; arrays are ``(n, 4)`` unless noted.

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
        self._room = np.full(shape, settings.buffer_bytes)
        self._silent: Bools = np.broadcast_to(at_ns >= 0, shape)
        self.after: dict[str, Any] = {**state, "buffer": state["buffer"].copy()}
        self.whole = np.zeros(shape, dtype=np.bool_)
        self.message = np.zeros(shape, dtype=frame.message)

    def take(self, run: int, connected: Bools | None, since_ns: Ints | None) -> None:
        """Read the arrived bytes of a run.

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
        """End messages that are followed by an idle character before these bytes."""
        idle = start - self.after["last_ns"] >= self._times.idle_ns
        self._close(np.flatnonzero(idle & (came > 0) & (self.after["length"] > 0)))

    def _pass(self, run: int, count: Ints) -> None:
        """Remove the first bytes of a run."""
        after = self.after
        after[f"left_{run}"] = after[f"left_{run}"] - count
        after[f"place_{run}"] = after[f"place_{run}"] + count
        after[f"start_{run}_ns"] = after[f"start_{run}_ns"] + count * self._times.byte_ns

    def _take_all(self, run: int, came: Ints) -> None:
        """Buffer bytes that are read as sent, as far as there is room."""
        after = self.after
        stored = np.minimum(came, self._room)
        self._room = self._room - stored
        after["overruns"] = after["overruns"] + (came - stored)
        after["received"] = after["received"] + stored
        # after kernels, the bursts of a line lie one behind the other
        copy_bytes(
            np.ascontiguousarray(_lines(after[f"data_{run // 2}"])),
            after[f"place_{run}"].reshape(-1),
            _lines(after["buffer"]),
            after["length"].reshape(-1),
            stored.reshape(-1),
        )
        after["length"] = np.minimum(after["length"] + stored, self._frame.length + 1)

    def _take_one_by_one(self, run: int, line: Ints, came: Ints) -> None:
        """Read bytes on lines with clocks so far apart that samples miss bits."""
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
        """Buffer one byte for each line, if there is room, and append it to the line's message.

        An interrupt drops a byte with a framing error at once; in a polled register it takes up the room.
        """
        room = self._room.reshape(-1)
        takes_room = np.ones(len(line), dtype=np.bool_) if self._settings.polled else ~fails
        full = takes_room & (room[line] == 0)
        self._count("overruns", line[full])
        self._count("framing", line[fails & ~full])
        room[line[takes_room & ~full]] -= 1
        stored = ~fails & ~full
        line, value = line[stored], value[stored]
        self._count("received", line)
        length = self.after["length"].reshape(-1)
        _lines(self.after["buffer"])[line, length[line]] = value
        length[line] = np.minimum(length[line] + 1, self._frame.length + 1)

    def end(self) -> None:
        """End messages whose end has been detected."""
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
        """End the bytes received on these lines as a message, or count a damaged message."""
        if not len(line):
            return
        length = self.after["length"].reshape(-1)
        good = length[line] == self._frame.length
        checked, message = self._frame.unpack(_lines(self.after["buffer"])[line[good]])
        whole = line[good][checked]
        self.whole.reshape(-1)[whole] = True
        self.message.reshape(-1)[whole] = message[checked]
        good[good] = checked
        self.after["damaged"] = self.after["damaged"].copy()
        self._count("damaged", line[~good])
        self.after["length"] = self.after["length"].copy()
        self.after["length"].reshape(-1)[line] = 0

    def _count(self, name: str, line: Ints) -> None:
        """Increment a counter on each of these lines; the counter must not be shared with the state."""
        self.after[name].reshape(-1)[line] += 1


def _lines(array: NDArray[Any]) -> NDArray[Any]:
    """Reshape to a row a line instead of a row a cell."""
    return array.reshape(-1, *array.shape[2:])


ErrorsOf = Callable[[Ints, Ints], Ints]
"""Errors of the clocks of the cells in these rows and columns, ppb, of any shape."""

_STEPS: Final = np.array(STEPS)
_TOGETHER: Final = 2
"""Bursts under way on a line where all is equal: that which comes, and the end of the last."""
_BY_OWN_CLOCKS: Final = 7
"""Most bursts stored where clocks are their own: where all may be empty but these, only those with bytes move on."""


@final
class Receiver:
    """Receiver of four lines, which assembles messages from bytes.

    A byte is there once its stop bit has been sampled, 9.5 bits after its start. It waits in the ring, or in the
    register, until the firmware reads it: one that finds no room is lost. A message is what comes between two idle
    characters; a driver that polls takes a period without a byte for one.

    The state keeps the runs of bytes that are under way: of each how many are left, when the next of them starts and
    its place in the burst's data.

    Args:
        settings: Of the lines.
        frame: Of the messages.
        burst: Of what a line carries in a window.
        window_ns: How long a window of the exchange is.
        errors_of: Clocks' errors; None where all are equal. With clocks of their own a cell learns of a window when it
            is over: all bytes come by ``window_ns`` and a bit later, so none comes before the cell learns of it, and
            what follows it on the line is known.

    Attributes:
        times: Of lines whose clocks are equal.
        shifts: Whether every window brings a burst, be it empty.
    """

    def __init__(
        self,
        settings: LineSettings,
        frame: Frame,
        burst: BurstType,
        window_ns: int,
        errors_of: ErrorsOf | None,
    ) -> None:
        self._settings = settings
        self._frame = frame
        self._burst = burst
        self._window_ns = window_ns
        self._errors_of = errors_of
        if errors_of is None:
            self._bursts, self.shifts = _TOGETHER, settings.byte_ns <= settings.period_ns
        else:
            windows = _windows(settings, window_ns)
            self._bursts, self.shifts = min(windows, _BY_OWN_CLOCKS), windows <= _BY_OWN_CLOCKS
        self._late_ns = 0 if errors_of is None else window_ns + settings.bit_ns
        self.times = LineTimes.of(settings, self._late_ns)

    def init(self, cells: Cells) -> State:
        """Return the initial state: nothing received."""
        lines, width = (len(cells), 4), self._burst.width
        runs = [f"{what}_{i}" for i in range(2 * self._bursts) for what in ("left", "place")]
        runs += [f"start_{i}_ns" for i in range(2 * self._bursts)]
        state: State = {
            "buffer": np.zeros((*lines, self._frame.length + 1 + width), dtype=np.uint8),
            **{f"data_{i}": np.zeros((*lines, width + WORD), dtype=np.uint8) for i in range(self._bursts)},
            **{name: np.zeros(lines, dtype=np.int64) for name in (*runs, "length", "last_ns", *COUNTERS)},
        }
        if self._errors_of is None:
            return state
        own, sender = neighbours_errors(self._errors_of, cells)
        return {**state, **LineTimes.of(self._settings, self._late_ns, own, sender).state()}

    def queue(self, window: int, state: State, lines: Inbox) -> State:
        """Queue the bursts that lines carried in the previous window.

        Args:
            window: In which the cells' instants lie.
            state: Of n cells.
            lines: ``(n, 4)`` bursts; empty where nothing was sent.
        """
        bursts = self._burst.from_wire(lines.message)
        begins, most = (window - 1) * self._window_ns, self._burst.width
        # bytes beyond a window's room are dropped, whatever a sender claims
        first = np.minimum(bursts["bytes_1"].astype(np.int64), most)
        data = np.zeros((*first.shape, self._burst.width + WORD), dtype=np.uint8)
        data[..., :-WORD] = bursts["byte"]
        new = {"data_0": data, "left_0": first, "place_0": np.zeros_like(first), "place_1": first}
        new["left_1"] = np.minimum(bursts["bytes_2"].astype(np.int64), most - first)
        for run in (0, 1):
            new[f"start_{run}_ns"] = begins + bursts[f"start_{run + 1}_ns"].astype(np.int64)
        return _queued(state, new, self._bursts, None if self.shifts else lines.received)

    def read(
        self, at_ns: Ints, state: State, connected: Bools | None = None, since_ns: Ints | None = None
    ) -> tuple[State, Inbox]:
        """Read the lines at the firmware's step.

        Args:
            at_ns: ``(n, 1)`` or ``(1,)``, when; negative for a cell that doesn't.
            state: Of n cells.
            connected: ``(n, 4)``, sides whose bytes got through since the last read; None: all.
            since_ns: ``(n, 1)``, since when they have.

        Returns:
            The next state, and whole messages.
        """
        times = self.times if self._errors_of is None else LineTimes.from_state(self._late_ns, state)
        reader = UartReader(self._settings, self._frame, times, 2 * self._bursts, state, at_ns)
        for run in range(2 * self._bursts):
            reader.take(run, connected, since_ns)
        reader.end()
        return reader.after, Inbox(reader.whole, reader.message)


def _windows(settings: LineSettings, window_ns: int) -> int:
    """For how many windows a burst may be under way where clocks are their own, off by 6 % at most.

    Its last byte starts within a period after the window, is there 9.5 bits, a window and a bit later, and is looked at
    within a period from then.
    """
    span_ns = 200 * window_ns + 212 * settings.period_ns + 1110 * settings.bit_ns  # hundredfold
    return -(-span_ns // (100 * window_ns))


def _queued(state: State, new: State, bursts: int, came: Bools | None) -> State:
    """The state with a burst more on each line; what is pushed out of the queue for it is lost.

    Args:
        state: Of n cells.
        new: The burst, named as if it were the first of the queue.
        bursts: How many there are in the queue.
        came: ``(n, 4)``, lines on which there is one; None: all, be it empty.
    """
    pushed_out = state["left_0"] + state["left_1"]
    after = {**state, "overruns": state["overruns"] + (pushed_out if came is None else pushed_out * came)}
    for i in range(bursts):
        for name, first in zip(_names(i), _names(0), strict=True):
            next_ = new[first] if i == bursts - 1 else state[_names(i + 1)[_names(0).index(first)]]
            if came is None:
                after[name] = next_
            else:
                mask = came if next_.ndim == came.ndim else came[..., None]
                after[name] = np.where(mask, next_, state[name])
    return after


def _names(burst: int) -> list[str]:
    """Return the names of the arrays of a burst in the queue."""
    runs = (2 * burst, 2 * burst + 1)
    return [f"data_{burst}", *(name for i in runs for name in (f"left_{i}", f"place_{i}", f"start_{i}_ns"))]


def neighbours_errors(errors_of: ErrorsOf, cells: Cells) -> tuple[Ints, Ints]:
    """Return the errors of the cells' own clocks, ``(n, 1)`` ppb, and of their neighbours', ``(n, 4)``."""
    own = errors_of(cells.row, cells.column)[:, None]
    return own, errors_of(cells.row[:, None] + _STEPS[:, 0], cells.column[:, None] + _STEPS[:, 1])
