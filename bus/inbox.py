"""The queue behind an endpoint: many threads put, one waits."""

from __future__ import annotations

import queue
import sys
import time
from collections import deque
from typing import Any, final


@final
class _Urgent:
    __slots__ = ("item",)

    def __init__(self, item: Any) -> None:
        self.item = item


@final
class Inbox:
    """First in, first out; the reader sleeps until *enough* has come, or something urgent.

    Waking a thread costs more than most events take to handle, and whoever waits for eighteen payloads can do
    nothing with the first. In the main thread the wait lets signal handlers run.
    """

    def __init__(self) -> None:
        self._items: deque[Any] = deque()
        self._urgent: deque[None] = deque()
        self._bell: queue.SimpleQueue[None] = queue.SimpleQueue()
        self._enough = sys.maxsize
        """How many items the sleeping reader waits for; out of reach while it is awake."""

    def put(self, item: Any) -> None:
        """Adds an item that may wait until the reader has enough. From any thread."""
        self._items.append(item)
        if len(self._items) >= self._enough:
            self._bell.put(None)

    def put_urgent(self, item: Any) -> None:
        """Adds an item that wakes the reader at once. From any thread, or a signal handler."""
        # Counted before it can be taken.
        self._urgent.append(None)
        self._items.append(_Urgent(item))
        self._bell.put(None)

    def get(self, timeout_s: float | None, enough: int) -> Any:
        """The oldest item, once there are ``enough`` or an urgent one.

        Args:
            timeout_s: Wall seconds after which any item will do, and None if there is none. 0: at once.
                None: never.
            enough: At least 1.
        """
        if len(self._items) < enough and timeout_s != 0 and not (self._items and self._urgent):
            self._sleep(timeout_s, enough)
        return self._pop() if self._items else None

    def get_all(self, timeout_s: float | None, enough: int) -> list[Any]:
        """As ``get``, but all that is there, oldest first."""
        items = self._items
        if len(items) < enough and timeout_s != 0 and not (items and self._urgent):
            self._sleep(timeout_s, enough)
        there = range(len(items))
        if self._urgent:
            return [self._pop() for _ in there]
        # An urgent item is counted before it is put: none of these can be one.
        take = items.popleft
        return [take() for _ in there]

    def _pop(self) -> Any:
        item = self._items.popleft()
        if type(item) is _Urgent:
            self._urgent.pop()
            return item.item
        return item

    def _sleep(self, timeout_s: float | None, enough: int) -> None:
        until = None if timeout_s is None else time.monotonic() + timeout_s
        left = timeout_s
        # From here on whoever puts rings the bell; what was put before is seen by the look at the items.
        self._enough = enough
        try:
            while len(self._items) < enough and not (self._items and self._urgent):
                # A bell left over from an earlier sleep wakes for nothing: hence the loop.
                self._bell.get(timeout=left)
                if until is not None:
                    left = max(until - time.monotonic(), 0.0)
        except queue.Empty:
            pass
        finally:
            self._enough = sys.maxsize
