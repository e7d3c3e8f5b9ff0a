"""The queue behind an endpoint: many threads put, one waits."""

from __future__ import annotations

import queue
import time
from collections.abc import Callable
from typing import Any, final


@final
class _Urgent:
    __slots__ = ("item",)

    def __init__(self, item: Any) -> None:
        self.item = item


@final
class Inbox:
    """First in, first out; the reader waits until *enough* has come, or something urgent.

    In the main thread the wait lets signal handlers run.

    Attributes:
        put: Adds an item that may wait until the reader has enough. From any thread.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.put: Callable[[Any], None] = self._queue.put

    def put_urgent(self, item: Any) -> None:
        """Adds an item that ends the wait at once. From any thread, or a signal handler."""
        self._queue.put(_Urgent(item))

    def take(self, timeout_s: float | None, enough: int) -> list[Any]:
        """All that is there, oldest first, once it is enough or something of it is urgent.

        Args:
            timeout_s: Wall seconds after which whatever there is will do. 0: at once. None: never.
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
