"""The transport inside one process: encoded bytes through queues."""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from typing import Any, Final, final

from bus.errors import TransportError
from bus.transports.base import Endpoint, Event, LivelinessChange, Publisher, Received, Urgency, Wakeup
from bus.wire.keys import intersects


@final
class _Urgent:
    __slots__ = ("item",)

    def __init__(self, item: Any) -> None:
        self.item = item


@final
class EventQueue:
    """First in, first out; the reader waits until *enough* has come, or something urgent.

    In the main thread the wait lets signal handlers run.

    Attributes:
        put: Adds an item that may wait until the reader has enough. From any thread.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.put: Callable[[Any], None] = self._queue.put

    def put_urgent(self, item: Any) -> None:
        """Add an item that ends the wait at once. From any thread, or a signal handler."""
        self._queue.put(_Urgent(item))

    def take(self, timeout_s: float | None, enough: int) -> list[Any]:
        """Return all items, oldest first, once there are enough or one is urgent.

        Args:
            timeout_s: Wall seconds after which all items present are returned. 0: at once. None: never.
            enough: At least 1.
        """
        items: list[Any] = []
        get, empty = self._queue.get, self._queue.empty
        until = None if timeout_s is None else time.monotonic() + timeout_s
        left = timeout_s
        try:
            while len(items) < enough or not empty():
                item = get(left != 0, left)
                if type(item) is _Urgent:
                    item, enough = item.item, 0
                items.append(item)
                if until is not None:
                    left = max(until - time.monotonic(), 0.0)
        except queue.Empty:
            pass  # the time is up
        return items


@final
class MemoryBus:
    """Rendezvous of the endpoints of one process. Thread-safe; ``put`` delivers before returning."""

    def __init__(self) -> None:
        self._lock = threading.RLock()
        self._endpoints: list[MemoryEndpoint] = []
        self._routes: dict[str, tuple[Callable[[Event], None], ...]] = {}
        self._tokens: dict[str, MemoryEndpoint] = {}

    def endpoint(self) -> MemoryEndpoint:
        """A new participant."""
        endpoint = MemoryEndpoint(self)
        with self._lock:
            self._endpoints.append(endpoint)
        return endpoint

    def route(self, key: str) -> tuple[Callable[[Event], None], ...]:
        """Return the ``put`` functions of all inboxes subscribed to ``key``."""
        route = self._routes.get(key)
        if route is None:
            with self._lock:
                route = tuple(door for e in self._endpoints if (door := e.queue_of(key)) is not None)
                self._routes[key] = route
        return route

    def put(self, key: str, payload: bytes) -> None:
        """Deliver ``payload`` to every subscriber of ``key``."""
        # A copy of the route, not the lock: two senders have no order between them anyway.
        event = Received(key, payload)
        for door in self.route(key):
            door(event)

    def subscribe(self, endpoint: MemoryEndpoint, key_expr: str, haste: Urgency) -> None:
        """Subscribe an endpoint to matching keys."""
        with self._lock:
            endpoint.subscriptions[key_expr] = haste
            self._routes.clear()

    def declare(self, key: str, endpoint: MemoryEndpoint) -> None:
        """Declare a token."""
        with self._lock:
            if key in self._tokens:
                raise TransportError(f"token {key} is declared already")
            self._tokens[key] = endpoint
            self._announce(LivelinessChange(key, True))

    def withdraw(self, key: str, endpoint: MemoryEndpoint) -> None:
        """Withdraw a token of ``endpoint``."""
        with self._lock:
            if self._tokens.get(key) is endpoint:
                del self._tokens[key]
                self._announce(LivelinessChange(key, False))

    def watch(self, key_expr: str, endpoint: MemoryEndpoint) -> None:
        """Begin to notify ``endpoint`` of matching tokens, present ones first."""
        with self._lock:
            endpoint.watches.append(key_expr)
            for key in self._tokens:
                if intersects(key_expr, key):
                    endpoint.enqueue(LivelinessChange(key, True))

    def leave(self, endpoint: MemoryEndpoint) -> None:
        """Remove ``endpoint`` and withdraw its tokens."""
        with self._lock:
            if endpoint in self._endpoints:
                self._endpoints.remove(endpoint)
            self._routes.clear()
            for key in [key for key, owner in self._tokens.items() if owner is endpoint]:
                self.withdraw(key, endpoint)

    def _announce(self, event: LivelinessChange) -> None:
        for endpoint in self._endpoints:
            if any(intersects(expr, event.key) for expr in endpoint.watches):
                endpoint.enqueue(event)


@final
class MemoryPublisher(Publisher):
    """Publisher on one key of a ``MemoryBus``."""

    def __init__(self, bus: MemoryBus, endpoint: MemoryEndpoint, key: str) -> None:
        self._bus = bus
        self._endpoint = endpoint
        self._key = key

    def put(self, payload: bytes) -> None:
        """Send ``payload`` to every subscriber of the key."""
        self._endpoint.check_open()
        self._bus.put(self._key, payload)

    def matched(self) -> bool:
        """Whether the key has a subscriber."""
        self._endpoint.check_open()
        return bool(self._bus.route(self._key))


_NUDGE: Final = object()
"""Ends the wait for a quiet payload."""


@final
class MemoryEndpoint(Endpoint):
    """A participant of a ``MemoryBus``; made by ``MemoryBus.endpoint``."""

    def __init__(self, bus: MemoryBus) -> None:
        super().__init__()
        self._bus = bus
        self._inbox = EventQueue()
        self._quiet: deque[Received] = deque()
        self._awaited: str | None = None
        self._doors: dict[Urgency, Callable[[Any], None]] = {
            "quiet": self._put_quiet,
            "wake": self._inbox.put,
            "urgent": self._inbox.put_urgent,
        }
        self._closed = False
        self.subscriptions: dict[str, Urgency] = {}
        self.watches: list[str] = []

    def publisher(self, key: str) -> Publisher:
        """A publisher on one key."""
        self.check_open()
        return MemoryPublisher(self._bus, self, key)

    def put_all(self, puts: Iterable[tuple[Publisher, bytes]]) -> None:
        """Put each payload with its publisher."""
        for publisher, payload in puts:
            publisher.put(payload)

    def subscribe(self, key_expr: str, haste: Urgency = "wake", *, direct: bool = False) -> None:  # noqa: ARG002 - one thread
        """Subscribe to matching keys."""
        self.check_open()
        if key_expr in self.subscriptions:
            return
        check_overlap(key_expr, list(self.subscriptions))
        self._bus.subscribe(self, key_expr, haste)

    def declare_alive(self, key: str) -> None:
        """Declare a token."""
        self.check_open()
        self._bus.declare(key, self)

    def withdraw(self, key: str) -> None:
        """Withdraw a token."""
        self.check_open()
        self._bus.withdraw(key, self)

    def watch_alive(self, key_expr: str) -> None:
        """Watch matching tokens."""
        self.check_open()
        self._bus.watch(key_expr, self)

    def receive_all(
        self, timeout_s: float | None, enough: int = 1, quiet_key: str | None = None
    ) -> list[Event]:
        """All events, the quiet first."""
        self.check_open()
        rest, self._rest = self._rest, []
        self._awaited = quiet_key  # before the look: what comes after it ends the wait
        there = any(self._is_awaited(event) for event in list(self._quiet))
        events = self._inbox.take(0 if rest or there else timeout_s, enough)
        self._awaited = None
        found = [event for event in events if event is not _NUDGE]
        return rest + [self._quiet.popleft() for _ in range(len(self._quiet))] + found

    def _put_quiet(self, event: Received) -> None:
        self._quiet.append(event)
        if self._is_awaited(event):
            self._inbox.put_urgent(_NUDGE)

    def _is_awaited(self, event: Received) -> bool:
        return self._awaited is not None and intersects(self._awaited, event.key)

    def wake(self) -> None:
        """Put one ``Wakeup`` in the inbox."""
        self._inbox.put_urgent(Wakeup())

    def close(self) -> None:
        """Withdraw all tokens and close the endpoint."""
        if not self._closed:
            self._bus.leave(self)
            self._closed = True

    def queue_of(self, key: str) -> Callable[[Event], None] | None:
        """Return the ``put`` function for payloads on ``key``; None if no subscription matches."""
        for expr, haste in self.subscriptions.items():
            if intersects(expr, key):
                return self._doors[haste]
        return None

    def enqueue(self, event: LivelinessChange) -> None:
        """Put a change of a token in the inbox."""
        self._inbox.put_urgent(event)

    def check_open(self) -> None:
        """Raise TransportError after ``close``."""
        if self._closed:
            raise TransportError("this endpoint is closed")


def check_overlap(key_expr: str, others: list[str]) -> None:
    """Refuse a subscription that would deliver a payload a second time.

    Raises:
        TransportError: ``key_expr`` shares a key with one of ``others``.
    """
    for other in others:
        # Two plain keys overlap only when equal, which the caller has looked for.
        if ("*" in key_expr or "*" in other) and intersects(key_expr, other):
            raise TransportError(f"subscribe to {key_expr}: overlaps {other}, which is subscribed already")
