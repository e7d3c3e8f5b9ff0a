"""What a session's reader waits on.

A callback of ours makes Zenoh's receiving threads wait for the interpreter: measured, a tenth of the exchange where
eighteen processes share two cores. Payloads therefore come through Zenoh's own channels, and the reader sleeps in
one of them, outside Python. That wait knows no time and no other channel; a bell ends it for whatever else happens.
"""

from __future__ import annotations

import ctypes
import os
import queue
import threading
import time
from collections.abc import Callable
from typing import Any, Final, final

import zenoh
from zenoh import handlers  # pyright: ignore[reportMissingModuleSource] - its source is the binary

from bus.transport import Event, Haste
from bus.transports.zenoh.alarm import Alarm
from bus.transports.zenoh.channel import Channel, drain, received

_SHORT_S: Final = 0.1
"""A wait up to this long looks every millisecond; a longer one may be late by the alarm's precision."""
_LOOK_S: Final = 0.001

_held: set[int] = set()
"""Receiving threads that keep their Python state."""
os.register_at_fork(after_in_child=_held.clear)  # those threads are not in the child


@final
class Mail:
    """The payloads of one session, and its *news*: whatever ends a wait at once.

    Args:
        session: The session.
    """

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._news: queue.SimpleQueue[Event] = queue.SimpleQueue()
        self._main: Channel | None = None
        self._waking: list[Channel] = []
        self._quiet: list[Channel] = []
        self._subscribers: list[object] = []
        self._alarm = Alarm(self._ring)

    def tell(self, event: Event) -> None:
        """Adds news. From any thread, or a signal handler."""
        self._news.put(event)
        self._ring()

    def teller(self, take: Callable[[zenoh.Sample], Event]) -> handlers.Callback[zenoh.Sample]:
        """A handler that makes news of each sample."""
        return handlers.Callback(_keep_state(lambda sample: self.tell(take(sample))), indirect=False)

    def subscribe(self, key_expr: str, haste: Haste) -> None:
        """Subscribes. The reader sleeps in the first channel that is to wake it; what any other brings is news."""
        if haste == "quiet":
            self._quiet.append(Channel(self._session, key_expr))
        elif haste == "wake" and self._main is None:
            self._main = Channel(self._session, key_expr)
            self._waking.append(self._main)
        else:
            self._subscribers.append(self._session.declare_subscriber(key_expr, self.teller(_payload)))

    def take(self, timeout_s: float | None, enough: int) -> list[Event]:
        """All that is there, once it is enough or there is news; see ``Endpoint``."""
        until = None if timeout_s is None else time.monotonic() + timeout_s
        left = timeout_s
        data: list[Event] = []
        news: list[Event] = []
        while True:
            if self._news.empty() and (left is None or left > 0.0):
                self._sleep(left, until, data, news)
            self._look(data, news)
            if news or len(data) >= enough or (left is not None and left <= 0.0):
                break
            left = None if until is None else until - time.monotonic()
        quiet: list[Event] = []
        drain(self._quiet, quiet)
        return quiet + data + news

    def close(self) -> None:
        """Ends what runs here."""
        self._alarm.close()

    def _look(self, data: list[Event], news: list[Event]) -> None:
        """Takes what is there: also all data of before the last news, and all news of before the last data."""
        empty = self._news.empty
        while True:
            drain(self._waking, data)
            if empty():
                return
            while not empty():
                news.append(self._news.get())

    def _sleep(self, left: float | None, until: float | None, data: list[Event], news: list[Event]) -> None:
        """Waits until something may have come, or the time is up."""
        main = self._main
        if main is None:
            try:
                news.append(self._news.get(timeout=left))
            except queue.Empty:
                return
        elif left is None:
            main.wait(data)
        elif left <= _SHORT_S:
            time.sleep(min(left, _LOOK_S))
        else:
            self._alarm.set(until)
            try:
                main.wait(data)
            finally:
                self._alarm.set(None)

    def _ring(self) -> None:
        if self._main is not None:
            self._main.ring()


def _payload(sample: zenoh.Sample) -> Event:
    return received((str(sample.key_expr), sample.payload.to_bytes()))


def _keep_state(call: Callable[[zenoh.Sample], None]) -> Callable[[zenoh.Sample], Any]:
    """``call``, made cheap for Zenoh's own threads.

    CPython gives a thread that it did not start a new state, and that state new memory pages, for every call into
    Python: a page fault and about 40 µs a sample. One hold that is never released lets the thread keep the
    state of its first call. There are few such threads and they live as long as the process.
    """
    hold = ctypes.pythonapi.PyGILState_Ensure

    def held_call(sample: zenoh.Sample) -> None:
        thread = threading.get_ident()
        if thread not in _held:
            _held.add(thread)
            hold()
        call(sample)

    return held_call
