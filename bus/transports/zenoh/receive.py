"""Receiving side of a Zenoh session: payload channels, events that end a wait, and a wakeup timer.

A Python callback makes Zenoh's receiving threads wait for the interpreter: measured, a tenth of the exchange where
eighteen processes share two cores. Payloads therefore come through Zenoh's own channels, and the reader sleeps in
one of them, outside Python. That wait has no timeout and covers no other channel; a bell ends it for other events.
"""

from __future__ import annotations

import contextlib
import functools
import queue
import threading
import time
from collections.abc import Callable
from typing import Any, Final, cast, final

import zenoh
from zenoh import handlers  # pyright: ignore[reportMissingModuleSource] - its source is the binary

from bus.errors import TransportError
from bus.transports.base import Event, Received, Urgency
from bus.transports.zenoh.direct import DirectChannel
from bus.transports.zenoh.receiving_thread import keep_state

PRECISION_S: Final = 0.1


@final
class WakeupTimer:
    """Timer that calls ``ring`` when its time has come, at most ``PRECISION_S`` late, and again until reset.

    Args:
        ring: Called by the timer's thread.
    """

    def __init__(self, ring: Callable[[], None]) -> None:
        self._ring = ring
        self._until: float | None = None
        self._thread: threading.Thread | None = None
        self._closed = threading.Event()

    def set(self, until: float | None) -> None:
        """Set the time to ring at (``time.monotonic``); None: never."""
        self._until = until
        if self._thread is None:
            self._thread = threading.Thread(target=self._watch, name="alarm", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """End the thread."""
        self._closed.set()

    def _watch(self) -> None:
        while not self._closed.wait(PRECISION_S):
            until = self._until
            if until is not None and time.monotonic() >= until:
                self._ring()


_CAPACITY: Final = 65_536
"""Payloads that wait for a reader; beyond it their senders do."""

received = cast(
    "Callable[[tuple[str, bytes]], Received]", functools.partial(cast("Any", tuple).__new__, Received)
)
"""As ``Received`` does, without a call into Python."""


@final
class Channel:
    """Payload channel of one subscription. The reader waits outside Python, without a Python callback.

    Args:
        session: The session.
        key_expr: What to subscribe to.

    Attributes:
        key: The key, where only one can match, so that samples need not be asked.
    """

    def __init__(self, session: zenoh.Session, key_expr: str) -> None:
        self._session = session
        self._subscriber = session.declare_subscriber(key_expr, handlers.FifoChannel(_CAPACITY))
        handler = cast("Any", self._subscriber.handler)
        self._recv: Callable[[], zenoh.Sample] = handler.recv
        self._try_recv: Callable[[], zenoh.Sample | None] = handler.try_recv
        self.key = None if "*" in key_expr else key_expr
        self._bell = key_expr.replace("**", "bell").replace("*", "bell")

    def wait(self, events: list[Event]) -> None:
        """Wait for a payload, and add it to ``events``, or for the bell."""
        try:
            sample = self._recv()
        except zenoh.ZError:
            raise TransportError("this endpoint was closed while it waited") from None
        payload = sample.payload.to_bytes()
        if payload or sample.kind == zenoh.SampleKind.PUT:
            events.append(received((self.key or str(sample.key_expr), payload)))

    def next(self) -> bytes | None:
        """Wait for a payload and return it; None for the bell."""
        try:
            sample = self._recv()
        except zenoh.ZError:
            raise TransportError("this endpoint was closed while it waited") from None
        payload = sample.payload.to_bytes()
        return payload if payload or sample.kind == zenoh.SampleKind.PUT else None

    def ring(self) -> None:
        """End the current wait, or the next, by a deletion, which is not used otherwise and stays in this session."""
        with contextlib.suppress(zenoh.ZError):  # The session may be closed already.
            cast("Any", self._session).delete(self._bell, allowed_destination=zenoh.Locality.SESSION_LOCAL)

    def drain(self, events: list[Event]) -> None:
        """Add the payloads present, at most the channel's capacity, so that fast senders can't prolong the call."""
        key, try_recv = self.key, self._try_recv
        for _ in range(_CAPACITY):
            if (sample := try_recv()) is None:
                break
            payload = sample.payload.to_bytes()
            if payload or sample.kind == zenoh.SampleKind.PUT:
                events.append(received((key or str(sample.key_expr), payload)))


_SHORT_S: Final = 0.1
"""A wait up to this long looks every millisecond; a longer one may be late by the alarm's precision."""
_LOOK_S: Final = 0.001


@final
class ReceiveQueue:
    """Receive queue of one session: payloads, and *news*, which are events that end a wait at once.

    Args:
        session: The session.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._news: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._main: Channel | DirectChannel | None = None
        self._waking: list[Channel | DirectChannel] = []
        self._quiet: dict[str, Channel] = {}
        self._awaited: Channel | DirectChannel | None = None
        """The channel that the reader waits in, now or at its next wait."""
        self._subscribers: list[object] = []
        self._alarm = WakeupTimer(self._ring)

    def enqueue(self, event: Event) -> None:
        """Add news. From any thread, or a signal handler."""
        self._news.put(event)
        self._ring()

    def enqueuer(self, take: Callable[[zenoh.Sample], Event]) -> handlers.Callback[zenoh.Sample]:
        """A handler that makes news of each sample."""
        return handlers.Callback(keep_state(lambda sample: self.enqueue(take(sample))), indirect=False)

    def subscribe(self, key_expr: str, haste: Urgency, direct: bool = False) -> None:
        """Subscribes. The reader sleeps in the first channel that is to wake it; what any other brings is news."""
        if haste == "quiet":
            self._quiet[key_expr] = Channel(self._session, key_expr)
        elif haste == "wake" and self._main is None:
            if direct:
                self._main = DirectChannel(self._session, key_expr, self._news.empty)
            else:
                self._main = Channel(self._session, key_expr)
            self._awaited = self._main
            self._waking.append(self._main)
        else:
            self._subscribers.append(self._session.declare_subscriber(key_expr, self.enqueuer(_payload)))

    def poll_all(self, timeout_s: float | None, enough: int, quiet_key: str | None = None) -> list[Event]:
        """All that is there, once it is enough or there is news; see ``Endpoint``."""
        data: list[Event] = []
        news: list[Event] = []
        if timeout_s is None and quiet_key is None and self._main is not None and not self._quiet:
            self._awaited = self._main
            while not news and len(data) < enough:
                if self._news.empty():
                    self._main.wait(data)
                self._look(data, news)
            return data + news if news else data
        until = None if timeout_s is None else time.monotonic() + timeout_s
        left = timeout_s
        quiet: list[Event] = []
        if quiet_key is None:
            self._awaited, found = self._main, data
        else:
            self._awaited, found, enough = self._quiet[quiet_key], quiet, 1
        while True:
            # Another thread adds news first and rings the awaited channel then: one of both is seen here.
            if self._news.empty() and (left is None or left > 0.0):
                self._sleep(left, until, found, news)
            self._look(data, news)
            if news or len(found) >= enough or (left is not None and left <= 0.0):
                break
            left = None if until is None else until - time.monotonic()
        for channel in self._quiet.values():
            channel.drain(quiet)
        return quiet + data + news

    def has_one_source(self, key: str) -> bool:
        """Return whether payloads of ``key`` are all that can come, but for news, and there is no news."""
        main = self._main
        return main is not None and main.key == key and not self._quiet and self._news.empty()

    def has_news(self) -> bool:
        """Return whether there is news."""
        return not self._news.empty()

    def next_payload(self) -> bytes | None:
        """Wait for a payload of the one source and return it; None where news ended the wait."""
        main = self._awaited = self._main
        assert main is not None, "this is a bug: a wait for payloads without a source"
        return main.next()

    def answer_payloads(self, answer: Callable[[bytes], bool]) -> bool:
        """Have payloads answered in Zenoh's thread; see ``Endpoint``. False: the source's are not."""
        main = self._main
        if not isinstance(main, DirectChannel):
            return False
        self._awaited = main
        main.serve(answer)
        return True

    def close(self) -> None:
        """End the timer's thread."""
        self._alarm.close()

    def _look(self, data: list[Event], news: list[Event]) -> None:
        """Take all data and news, including data put before the last news, and news put before the last data."""
        empty = self._news.empty
        while True:
            for channel in self._waking:
                channel.drain(data)
            if empty():
                return
            while not empty():
                news.append(self._news.get())

    def _sleep(self, left: float | None, until: float | None, found: list[Event], news: list[Event]) -> None:
        """Wait until an event may have arrived, or the time is up.

        Args:
            left: Wall seconds to wait; None: any time.
            until: When that is over, by ``time.monotonic``.
            found: Events to add a payload of the awaited channel to.
            news: Events to add news to, where there is no channel.
        """
        awaited = self._awaited
        if awaited is None:
            try:
                news.append(self._news.get(timeout=left))
            except queue.Empty:
                return
        elif left is None:
            awaited.wait(found)
        elif left <= _SHORT_S:
            time.sleep(min(left, _LOOK_S))
        else:
            self._alarm.set(until)
            try:
                awaited.wait(found)
            finally:
                self._alarm.set(None)

    def _ring(self) -> None:
        if (awaited := self._awaited) is not None:
            awaited.ring()


def _payload(sample: zenoh.Sample) -> Event:
    return received((str(sample.key_expr), sample.payload.to_bytes()))
