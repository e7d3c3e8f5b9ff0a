"""Links between cells with different clocks: a mailbox holds the newest message until it is read."""

from __future__ import annotations

from typing import Any, ClassVar, final

import numpy as np
from numpy.typing import NDArray

from bus.lattice import SIDES
from cell_firmware.components import LinkDriver
from cell_firmware.controller import StepTime
from cell_firmware.firmware import Bools, Cells, Inbox, Messages, Outbox, State, opaque_view


@final
class Mailbox(LinkDriver):
    """Link driver that delivers whole messages, each a window after it was sent.

    One that is sent at r is there for its receiver from r + W on, W being the window; the receiver reads it at its
    first instant not before that, once. Each link holds one message: a newer one that is there before the receiver
    read replaces the older, and that is counted.

    An exchange brings what was sent in one window to cells that step in the next. So which of the two is earlier in
    its window decides, and that is what a message carries: a link that delays it by whole windows changes nothing else.

    Args:
        message: The program's type.
        window_ns: W.
    """

    effect: ClassVar[str] = "clock"

    def __init__(self, message: np.dtype[Any], window_ns: int) -> None:
        self._message = message
        self._names: tuple[str, ...] = message.names or ()
        self._stamp = "after_ns"
        while self._stamp in self._names:
            self._stamp += "_"
        self._window_ns = window_ns
        self.line = np.dtype([(self._stamp, "<i8"), *((name, message[name]) for name in self._names)])

    def init(self, cells: Cells) -> State:
        """Return empty mailboxes, ``(n, 4)``, with zero counters of replaced messages, ``(n, 4)``."""
        shape = (len(cells), len(SIDES))
        return {
            "waits": np.zeros(shape, dtype=np.bool_),
            "message": np.zeros(shape, dtype=self._message),
            "overwritten": np.zeros(shape, dtype=np.int64),
        }

    def constants(self) -> NDArray[Any]:
        """Return the window as a record of ``kernels.lines.LINES``."""
        from cell_firmware.kernels.lines import LINES, MAILBOX

        links = np.zeros(1, dtype=LINES)
        links["kind"], links["window_ns"] = MAILBOX, self._window_ns
        return links

    def reset(self, cells: Cells, state: State) -> State:
        """Empty the mailboxes; counters belong to the observer and are retained."""
        return {**self.init(cells), "overwritten": state["overwritten"]}

    def receive(self, now: StepTime, state: State, lines: Inbox) -> tuple[State, Inbox]:
        """Return waiting messages, and messages that arrive in time, for the cells that are stepped."""
        steps, into_ns = (now.at_ns >= 0)[:, None], (now.at_ns % self._window_ns)[:, None]
        came, waits = lines.received, state["waits"]
        message = np.zeros(came.shape, dtype=self._message)
        for name in self._names:
            message[name] = lines.message[name]
        in_time = came & steps & (lines.message[self._stamp] <= into_ns)
        received = in_time | (waits & steps)
        stays, waiting = came & ~in_time, waits & ~steps
        after = {
            "waits": stays | waiting,
            "message": _either(stays, message, waiting, state["message"]),
            "overwritten": state["overwritten"] + (came & waits & (in_time | ~steps)),
        }
        return after, Inbox(received, _either(in_time, message, received, state["message"]))

    def send(self, now: StepTime, state: State, outbox: Outbox | None) -> tuple[State, Outbox]:
        """Add the send time in the window to the messages."""
        n = len(now.at_ns)
        if outbox is None:
            return state, Outbox.empty(n, self.line)
        line = np.empty((n, len(SIDES)), dtype=self.line)
        line[self._stamp] = (now.at_ns % self._window_ns)[:, None]
        for name in self._names:
            line[name] = outbox.message[name]
        return state, Outbox(outbox.sent, line)

    def registers(self, state: State) -> dict[str, NDArray[Any]]:
        """Return which sides have a waiting message, and the numbers of replaced messages."""
        return {"waits": state["waits"], "overwritten": state["overwritten"]}

    def counters(self, state: State) -> dict[str, int]:
        """Return the number of messages replaced before being read."""
        return {"overwritten": int(state["overwritten"].sum())}


def _either(first: Bools, message: Messages, second: Bools, other: Messages) -> Messages:
    """Select ``message`` where ``first`` is true, else ``other`` where ``second`` is true; zeros elsewhere."""
    found = np.where(first, message, other)
    whole = opaque_view(found)
    whole[~(first | second)] = np.zeros((), dtype=whole.dtype)
    return found
