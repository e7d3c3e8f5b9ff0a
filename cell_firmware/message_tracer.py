"""Record of the messages that the program of a cell reads and sends, for one who traces messages."""

from __future__ import annotations

from typing import Any, Final, final

import numpy as np
from numpy.typing import NDArray

from bus.wire.message_type import leaves
from cell_firmware.components import BoardComponent
from cell_firmware.firmware import Cells, Inbox, Outbox, State

TRACE: Final = "trace"
"""Name of the part, and prefix of its registers."""


def trace_registers(message: np.dtype[Any]) -> tuple[str, ...]:
    """Return the names of the registers of a tracer, in their order.

    Args:
        message: Type of the program's messages.
    """
    fields = [f"{way}.{leaf.name}" for way in ("read", "sent") for leaf in leaves(message)]
    return tuple(f"{TRACE}.{name}" for name in ("tick", "received", "sent", *fields))


@final
class MessageTracer(BoardComponent):
    """Whole messages as the program has them: read after all effects and faults of links, sent before all of them.

    The record belongs to the observer: a reset does not change it.

    Args:
        message: Type of the program's messages.
    """

    def __init__(self, message: np.dtype[Any]) -> None:
        self._message = message

    def init(self, cells: Cells) -> State:
        """Return the record before the first step: no messages, and tick -1."""
        flags, messages = np.zeros((len(cells), 4), dtype=np.bool_), np.zeros((len(cells), 4), self._message)
        return {
            "tick": np.full(len(cells), -1, dtype=np.int64),
            "received": flags,
            "read_message": messages,
            "sent": flags.copy(),
            "sent_message": messages.copy(),
        }

    def reset(self, cells: Cells, state: State) -> State:
        """Return the state unchanged."""
        del cells
        return state

    def keep(self, tick: int, state: State, inbox: Inbox | None, outbox: Outbox | None) -> State:
        """Return the record of a control period.

        Args:
            tick: Tick of the control period.
            state: Record of n cells before.
            inbox: Messages that the program read; None: none.
            outbox: Messages that the program sent; None: none.
        """
        none = Inbox(np.zeros_like(state["sent"]), np.zeros_like(state["sent_message"]))
        inbox = none if inbox is None else inbox
        outbox = Outbox(none.received, none.message) if outbox is None else outbox
        return {
            "tick": np.full_like(state["tick"], tick),
            "received": inbox.received.copy(),
            "read_message": np.where(inbox.received, inbox.message, none.message),
            "sent": outbox.sent.copy(),
            "sent_message": np.where(outbox.sent, outbox.message, none.message),
        }

    def registers(self, state: State) -> dict[str, NDArray[Any]]:
        """Return the record: flags by side, and each field of the messages by side."""
        read, sent = state["read_message"], state["sent_message"]
        parts = leaves(self._message)
        return {
            **{name: state[name] for name in ("tick", "received", "sent")},
            **{f"read.{leaf.name}": np.ascontiguousarray(leaf.of(read)) for leaf in parts},
            **{f"sent.{leaf.name}": np.ascontiguousarray(leaf.of(sent)) for leaf in parts},
        }
