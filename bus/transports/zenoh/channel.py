"""One of Zenoh's channels, and the bell that ends a wait on it."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Callable, Iterable
from typing import Any, Final, cast, final

import zenoh
from zenoh import handlers  # pyright: ignore[reportMissingModuleSource] - its source is the binary

from bus.errors import TransportError
from bus.transport import Event, Received

_CAPACITY: Final = 65_536
"""Payloads that wait for a reader; beyond it their senders do."""

received = cast(
    "Callable[[tuple[str, bytes]], Received]", functools.partial(cast("Any", tuple).__new__, Received)
)
"""As ``Received`` does, without a call into Python."""


@final
class Channel:
    """What comes on one subscription. Its reader waits outside Python, and needs no callback of ours.

    Args:
        session: The session.
        key_expr: What to subscribe to.

    Attributes:
        key: The key, where only one can match: nobody need ask the sample for it.
        try_recv: Zenoh's own: a sample, or None where there is none.
    """

    def __init__(self, session: zenoh.Session, key_expr: str) -> None:
        self._session = session
        self._subscriber = session.declare_subscriber(key_expr, handlers.FifoChannel(_CAPACITY))
        handler = cast("Any", self._subscriber.handler)
        self._recv: Callable[[], zenoh.Sample] = handler.recv
        self.try_recv: Callable[[], zenoh.Sample | None] = handler.try_recv
        self.key = None if "*" in key_expr else key_expr
        self._bell = key_expr.replace("**", "bell").replace("*", "bell")

    def wait(self, events: list[Event]) -> None:
        """Waits for a payload, which it adds, or for the bell."""
        try:
            sample = self._recv()
        except zenoh.ZError:
            raise TransportError("this endpoint was closed while it waited") from None
        payload = sample.payload.to_bytes()
        if payload or sample.kind == zenoh.SampleKind.PUT:
            events.append(received((self.key or str(sample.key_expr), payload)))

    def ring(self) -> None:
        """Ends a wait, or the next: a deletion, which nobody puts on these keys, and that stays in this session."""
        with contextlib.suppress(zenoh.ZError):  # The session may be closed already.
            cast("Any", self._session).delete(self._bell, allowed_destination=zenoh.Locality.SESSION_LOCAL)


def drain(channels: Iterable[Channel], events: list[Event]) -> None:
    """Adds the payloads that are there; of each channel no more than it can hold, however fast others come after."""
    for channel in channels:
        key, try_recv = channel.key, channel.try_recv
        for _ in range(_CAPACITY):
            if (sample := try_recv()) is None:
                break
            payload = sample.payload.to_bytes()
            if payload or sample.kind == zenoh.SampleKind.PUT:
                events.append(received((key or str(sample.key_expr), payload)))
