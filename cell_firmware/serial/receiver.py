"""The receiving half of a cell's four lines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, final

import numpy as np

from bus.lattice import STEPS
from cell_firmware.firmware import Bools, Cells, Inbox, State
from cell_firmware.serial.bursts import BurstType
from cell_firmware.serial.frames import Frame
from cell_firmware.serial.look import COUNTERS, Look
from cell_firmware.serial.settings import Ints, LineSettings
from cell_firmware.serial.times import LineTimes
from cell_firmware.serial.words import WORD

ErrorsOf = Callable[[Ints, Ints], Ints]
"""Errors of the clocks of the cells in these rows and columns, ppb, of any shape."""

_STEPS: Final = np.array(STEPS)
_TOGETHER: Final = 2
"""Bursts under way on a line where all is equal: that which comes, and the end of the last."""
_BY_OWN_CLOCKS: Final = 7
"""Most that are kept where clocks are their own: where all may be empty but these, only those with bytes move on."""


@final
class Receiver:
    """Collects the bytes that have come over four lines, and puts messages together.

    A byte is there once its stop bit has been sampled, 9.5 bits after its start. It waits in the ring, or in the
    register, until the firmware looks: one that finds no room is lost. A message is what comes between two idle
    characters; a driver that polls takes a period without a byte for one.

    The state keeps the runs of bytes that are under way: of each how many are left, when the next of them starts and
    its place in the burst's data.

    Args:
        settings: Of the lines.
        frame: Of the messages.
        burst: Of what a line carries in a window.
        window_ns: How long a window of the exchange is.
        errors_of: Clocks' errors; None where all are equal. With clocks of their own a cell hears of a window when it
            is over: all bytes come by ``window_ns`` and a bit later, so that none has come before it was heard of, and
            what follows it on the line is known.
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
            self._bursts, self._keep_step = _TOGETHER, settings.byte_ns <= settings.period_ns
        else:
            windows = _windows(settings, window_ns)
            self._bursts, self._keep_step = min(windows, _BY_OWN_CLOCKS), windows <= _BY_OWN_CLOCKS
        self._late_ns = 0 if errors_of is None else window_ns + settings.bit_ns
        self._times = LineTimes.of(settings, self._late_ns)

    def init(self, cells: Cells) -> State:
        """Nothing has come."""
        lines, width = (len(cells), 4), self._burst.width
        runs = [f"{what}_{i}" for i in range(2 * self._bursts) for what in ("left", "place")]
        runs += [f"start_{i}_ns" for i in range(2 * self._bursts)]
        state: State = {
            "heard": np.zeros((*lines, self._frame.length + 1 + width), dtype=np.uint8),
            **{f"data_{i}": np.zeros((*lines, width + WORD), dtype=np.uint8) for i in range(self._bursts)},
            **{name: np.zeros(lines, dtype=np.int64) for name in (*runs, "length", "last_ns", *COUNTERS)},
        }
        if self._errors_of is None:
            return state
        own, sender = neighbours_errors(self._errors_of, cells)
        return {**state, **LineTimes.of(self._settings, self._late_ns, own, sender).state()}

    def hear(self, window: int, state: State, lines: Inbox) -> State:
        """Takes in what lines carried in the window before.

        Args:
            window: In which the cells' instants lie.
            state: Of n cells.
            lines: ``(n, 4)`` bursts; empty where nothing was sent.
        """
        bursts = self._burst.from_wire(lines.message)
        begins, most = (window - 1) * self._window_ns, self._burst.width
        # of more bytes than a window has room for nobody hears, whatever a sender claims
        first = np.minimum(bursts["bytes_1"].astype(np.int64), most)
        data = np.zeros((*first.shape, self._burst.width + WORD), dtype=np.uint8)
        data[..., :-WORD] = bursts["byte"]
        new = {"data_0": data, "left_0": first, "place_0": np.zeros_like(first), "place_1": first}
        new["left_1"] = np.minimum(bursts["bytes_2"].astype(np.int64), most - first)
        for run in (0, 1):
            new[f"start_{run}_ns"] = begins + bursts[f"start_{run + 1}_ns"].astype(np.int64)
        return _queued(state, new, self._bursts, None if self._keep_step else lines.received)

    def look(
        self, at_ns: Ints, state: State, connected: Bools | None = None, since_ns: Ints | None = None
    ) -> tuple[State, Inbox]:
        """The firmware looks at its lines.

        Args:
            at_ns: ``(n, 1)`` or ``(1,)``, when; negative for a cell that doesn't.
            state: Of n cells.
            connected: ``(n, 4)``, sides whose bytes got through since the last look; None: all.
            since_ns: ``(n, 1)``, since when they have.

        Returns:
            The next state, and whole messages.
        """
        times = self._times if self._errors_of is None else LineTimes.from_state(self._late_ns, state)
        look = Look(self._settings, self._frame, times, 2 * self._bursts, state, at_ns)
        for run in range(2 * self._bursts):
            look.take(run, connected, since_ns)
        look.end()
        return look.after, Inbox(look.whole, look.message)


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
    """Arrays of a burst in the queue."""
    runs = (2 * burst, 2 * burst + 1)
    return [f"data_{burst}", *(name for i in runs for name in (f"left_{i}", f"place_{i}", f"start_{i}_ns"))]


def neighbours_errors(errors_of: ErrorsOf, cells: Cells) -> tuple[Ints, Ints]:
    """Errors of the cells' own clocks, ``(n, 1)`` ppb, and of their neighbours', ``(n, 4)``."""
    own = errors_of(cells.row, cells.column)[:, None]
    return own, errors_of(cells.row[:, None] + _STEPS[:, 0], cells.column[:, None] + _STEPS[:, 1])
