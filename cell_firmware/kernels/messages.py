"""Messages as bytes: every type of message has the same kernels."""

from __future__ import annotations

from cell_firmware.kernels.jit import INTEGER, entry, kernel, read, written


@kernel
def copy(source, target):
    """Copy the bytes of a message."""
    for b in range(len(target)):
        target[b] = source[b]


@kernel
def clear(target):
    """Make all bytes of a message zero."""
    for b in range(len(target)):
        target[b] = 0


@kernel
def copy_slot(size, source, start, target, end):
    """Copy the message of a slot to another, among messages that lie one after the other."""
    for b in range(size):
        target[size * end + b] = source[size * start + b]


@entry(
    INTEGER, read("?", 1), read("u1", 1), read("i8", 1), read("i8", 1), read("?", 1), read("u1", 1), read("i8", 1),
    written("?", 1), written("u1", 1),
)  # fmt: skip
def collect(size, sent, outgoing, inner_from, inner_to, border_sent, border, border_to, received, message):
    """Collect the messages of a shard's cells from the slots of the last tick, and from the border.

    Args:
        size: Bytes of a message.
        sent: ``(4 n,)`` bool, whether a slot of the outbox has a message.
        outgoing: ``(4 n size,)`` uint8, the outbox.
        inner_from: ``(m,)``, slots of the outbox, ...
        inner_to: ``(m,)``, ... and the slots of the inbox that they lead to.
        border_sent: ``(l,)`` bool, whether a message came over a link of the border.
        border: ``(l size,)`` uint8, these messages.
        border_to: ``(l,)``, the slots of the inbox that they lead to.
        received: ``(4 n,)`` bool, all false; is filled.
        message: ``(4 n size,)`` uint8, zeros; is filled.
    """
    for k in range(len(inner_to)):
        if sent[inner_from[k]]:
            received[inner_to[k]] = True
            copy_slot(size, outgoing, inner_from[k], message, inner_to[k])
    for k in range(len(border_sent)):
        if border_sent[k]:
            received[border_to[k]] = True
            copy_slot(size, border, k, message, border_to[k])


@entry(INTEGER, read("?", 1), read("u1", 1), read("i8", 1), written("?", 1), written("u1", 1))
def leave(size, sent, outgoing, border_from, border_sent, border):
    """Take the messages that leave a shard over its border; as ``collect``, with ``(l,)`` slots of the outbox.

    Args:
        size: Bytes of a message.
        sent: ``(4 n,)`` bool.
        outgoing: ``(4 n size,)`` uint8.
        border_from: ``(l,)``, the slot of the outbox of every link.
        border_sent: ``(l,)`` bool, all false; is filled.
        border: ``(l size,)`` uint8, zeros; is filled.
    """
    for k in range(len(border_from)):
        if sent[border_from[k]]:
            border_sent[k] = True
            copy_slot(size, outgoing, border_from[k], border, k)
