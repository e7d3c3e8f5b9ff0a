"""Message-level serial lines: whole messages arrive when the last byte would, where bytes can't be disturbed."""

from __future__ import annotations

from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from cell_firmware.components import LinkDriver
from cell_firmware.controller import StepTime
from cell_firmware.effects.serial.framing import bytes_of
from cell_firmware.effects.serial.receiver import COUNTERS, ErrorsOf, neighbours_errors
from cell_firmware.effects.serial.timing import LONGEST_PERIOD_NS, Ints, LineSettings, LineTimes, by_clock
from cell_firmware.firmware import Bools, Cells, Inbox, Messages, Outbox, State

_NEVER: Final = np.iinfo(np.int64).max
_MOST_WINDOWS: Final = 8
"""Most windows between a message's last byte and its delivery; beyond, byte-level lines are cheaper."""
_BILLION: Final = 1_000_000_000


def is_exact_for(settings: LineSettings, window_ns: int, worst_ppb: int) -> bool:
    """Whether every byte that is sent comes, and is read as it was sent.

    That is so where interrupts fill a ring that holds all that can come between two reads, every side has a UART, and
    no two clocks are so far apart that a sample misses its bit. Links must lose and delay nothing either.

    Args:
        settings: Of the lines.
        window_ns: How long a window of the exchange is.
        worst_ppb: Greatest error of a clock, either way.
    """
    fast, slow = _BILLION - worst_ppb, _BILLION + worst_ppb
    # the last sample, of the stop bit, is 9.5 of the receiver's bits after the start
    in_bit = 18 * slow <= 19 * fast and 19 * slow < 20 * fast
    between_reads = settings.period_ns * slow // (settings.byte_ns * fast) + 2
    return (
        settings.period_ns <= LONGEST_PERIOD_NS
        and not settings.polled
        and settings.dwell_periods is None
        and in_bit
        and between_reads <= settings.buffer_bytes
        and _windows(settings, window_ns) <= _MOST_WINDOWS
    )


def _windows(settings: LineSettings, window_ns: int) -> int:
    """Return the number of exchanges that a message can wait before delivery, plus one."""
    return (settings.period_ns + 3 * settings.byte_ns) // window_ns + 3


@final
class MessageLevelLines(LinkDriver):
    """Message-level equivalent of ``SerialLines`` where ``is_exact_for`` holds; costs a step a message, not a byte.

    A sender keeps a message until the step in which the last byte is sent, so that a message cut short by the cell's
    death or reset is never delivered. A receiver holds it until the following idle character has passed. After a reset,
    a receiver ignores messages that had begun before. Counters count whole messages.

    Args:
        settings: Of the lines.
        message: The program's message type.
        window_ns: How long a tick is; None: a control period.
        errors_of: Clocks' errors, for cells with clocks of their own; None: all are equal.
    """

    def __init__(
        self,
        settings: LineSettings,
        message: np.dtype[Any],
        window_ns: int | None = None,
        errors_of: ErrorsOf | None = None,
    ) -> None:
        self._settings = settings
        self._message = message
        self._names: tuple[str, ...] = message.names or ()
        self._window_ns = settings.period_ns if window_ns is None else window_ns
        self._errors_of = errors_of
        self._length = bytes_of(message)
        self._slots = _windows(settings, self._window_ns)
        self._last, self._began = (_other_than(self._names, name) for name in ("last_ns", "began"))
        fields = [(name, message[name]) for name in self._names]
        self.line = np.dtype([(self._last, "<i4"), (self._began, "<u4"), *fields])

    def init(self, cells: Cells) -> State:
        """Return the state of empty lines, with zero counters."""
        lines = (len(cells), 4)
        late_ns = 0 if self._errors_of is None else self._window_ns + self._settings.bit_ns
        own = sender = None
        if self._errors_of is not None:
            own, sender = neighbours_errors(self._errors_of, cells)
        times = LineTimes.of(self._settings, late_ns, own, sender)
        state: dict[str, NDArray[Any]] = {
            "reaches": cells.has_neighbour.copy(),
            "whole_ns": np.broadcast_to(times.idle_ns + late_ns, lines).copy(),
            "since": np.zeros((len(cells), 1), dtype=np.int64),
            "waiting": np.zeros(lines, dtype=self._message),
            "waits": np.zeros(lines, dtype=np.bool_),
            "going": np.zeros(lines, dtype=self._message),
            "goes": np.zeros(lines, dtype=np.bool_),
            "began": np.zeros(lines, dtype=np.int64),
            "last_ns": np.zeros(lines, dtype=np.int64),
            "free_ns": np.zeros(lines, dtype=np.int64),
            **{name: np.zeros(lines, dtype=np.int64) for name in _COUNTED},
        }
        for slot in range(self._slots):
            state[f"there_{slot}_ns"] = np.full(lines, _NEVER)
            state[f"message_{slot}"] = np.zeros(lines, dtype=self.line)
        if own is not None:
            state["ppb"] = own
        return state

    def constants(self) -> NDArray[Any]:
        """Return lengths and times as a record of ``kernels.lines.LINES``."""
        from cell_firmware.kernels.lines import LINES, SERIAL

        links = np.zeros(1, dtype=LINES)
        links["kind"], links["window_ns"], links["period_ns"] = (
            SERIAL,
            self._window_ns,
            self._settings.period_ns,
        )
        links["byte_ns"], links["length"], links["slots"] = self._settings.byte_ns, self._length, self._slots
        return links

    def reset(self, cells: Cells, state: State) -> State:
        """Empty the lines, including messages in transmission; counters belong to the observer and are retained."""
        since = np.full_like(state["since"], -1)  # until the next exchange sets it
        return {**self.init(cells), "since": since, **{name: state[name] for name in _COUNTED}}

    def receive(self, now: StepTime, state: State, lines: Inbox) -> tuple[State, Inbox]:
        """Return messages received since the cells' last step; of two on a side the later one."""
        sent_in = now.tick - 1
        since = np.where(state["since"] < 0, sent_in, state["since"])
        began = sent_in - lines.message[self._began].astype(np.int64)
        accepted = lines.received & (began >= since)
        there_ns = sent_in * self._window_ns + lines.message[self._last].astype(np.int64) + state["whole_ns"]
        new = now.tick % self._slots
        after = {
            **state,
            "since": since,
            f"there_{new}_ns": np.where(accepted, there_ns, _NEVER),
            f"message_{new}": lines.message,
        }
        whole = np.zeros(accepted.shape, dtype=np.bool_)
        message = np.zeros(accepted.shape, dtype=self._message)
        at_ns = now.at_ns[..., None]
        for slot in range(new + 1, new + 1 + self._slots):  # the oldest first
            self._take(after, slot % self._slots, at_ns, whole, message)
        return after, Inbox(whole, message)

    def _take(
        self, after: dict[str, NDArray[Any]], slot: int, at_ns: Ints, whole: Bools, message: Messages
    ) -> None:
        """Deliver the arrived messages of a slot."""
        there_ns = after[f"there_{slot}_ns"]
        come = there_ns <= at_ns
        row = np.flatnonzero(come)
        if not len(row):
            return
        after[f"there_{slot}_ns"] = np.where(come, _NEVER, there_ns)
        after["received"] = after["received"] + self._length * come
        whole |= come
        source = after[f"message_{slot}"].reshape(-1)
        for name in self._names:
            message.reshape(-1)[name][row] = source[name][row]

    def send(self, now: StepTime, state: State, outbox: Outbox | None) -> tuple[State, Outbox]:
        """Send the messages whose last byte starts before the cells' next step."""
        after = dict(state)
        at_ns, ppb = now.at_ns[..., None], state.get("ppb")
        next_ns = at_ns + by_clock(self._settings.period_ns, ppb)
        byte_ns = by_clock(self._settings.byte_ns, ppb)
        if outbox is not None:
            _put_aside(after, outbox)
        ends = after["goes"] & (after["last_ns"] < next_ns)
        begins = after["waits"] & (~after["goes"] | ends) & (after["free_ns"] < next_ns)
        line = np.zeros(ends.shape, dtype=self.line)
        self._fill(line, np.flatnonzero(ends), after["going"], after, now.tick)
        if begins.any():
            start_ns = np.maximum(after["free_ns"], at_ns)
            last_ns = start_ns + (self._length - 1) * byte_ns
            after["last_ns"] = np.where(begins, last_ns, after["last_ns"])
            after["free_ns"] = np.where(begins, last_ns + 2 * byte_ns, after["free_ns"])
            after["began"] = np.where(begins, now.tick, after["began"])
            after["waits"] = after["waits"] & ~begins
            at_once = begins & ~ends & (last_ns < next_ns)
            self._fill(line, np.flatnonzero(at_once), after["waiting"], after, now.tick)
            stays = np.flatnonzero(begins & ~at_once)
            if len(stays):
                after["going"] = after["going"].copy()
                for name in self._names:
                    after["going"].reshape(-1)[name][stays] = after["waiting"].reshape(-1)[name][stays]
            after["goes"] = (after["goes"] & ~ends) | (begins & ~at_once)
            ends = ends | at_once
        else:
            after["goes"] = after["goes"] & ~ends
        after["sent"] = after["sent"] + self._length * ends
        return after, Outbox(ends, line)

    def _fill(
        self, line: Messages, row: NDArray[np.int64], source: Messages, after: State, window: int
    ) -> None:
        """Write messages of these links, with the start times of the first and last bytes."""
        line[self._last].reshape(-1)[row] = after["last_ns"].reshape(-1)[row] - window * self._window_ns
        line[self._began].reshape(-1)[row] = window - after["began"].reshape(-1)[row]
        for name in self._names:
            line.reshape(-1)[name][row] = source.reshape(-1)[name][row]

    def registers(self, state: State) -> dict[str, NDArray[Any]]:
        """Return the counters of each side, ``(n, 4)``; zero for events that can't occur."""
        nothing = np.zeros_like(state["sent"])
        return {name: state.get(name, nothing) for name in ("sent", *COUNTERS, "replaced")}

    def counters(self, state: State) -> dict[str, int]:
        """Return the counters summed over all sides of all cells."""
        return {name: int(value.sum()) for name, value in self.registers(state).items()}


_COUNTED: Final = ("sent", "received", "replaced")


def _put_aside(after: dict[str, NDArray[Any]], outbox: Outbox) -> None:
    """Queue the program's messages, which replace waiting ones."""
    sent = outbox.sent
    fresh = sent & after["reaches"]
    after["replaced"] = after["replaced"] + (fresh & after["waits"])
    after["waiting"] = outbox.message if sent.all() else np.where(sent, outbox.message, after["waiting"])
    after["waits"] = after["waits"] | fresh


def _other_than(names: tuple[str, ...], name: str) -> str:
    """Return the name, with underscores appended until it differs from all ``names``."""
    while name in names:
        name += "_"
    return name
