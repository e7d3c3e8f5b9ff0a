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

    Waking a thread costs more than most items take to handle: what need not wake the reader waits in sources of
    its own, and is taken from there when the wait has ended. In the main thread the wait lets signal handlers run.

    Attributes:
        put: Adds an item that may wait until the reader has enough. From any thread; no Python runs for it.
        quiet: Sources that the reader asks, without waiting, for an item or None.
    """

    def __init__(self) -> None:
        self._queue: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self._rest: list[Any] = []
        """Taken, but not handed over yet."""
        self.put: Callable[[Any], None] = self._queue.put
        self.quiet: list[Callable[[], Any]] = []

    def put_urgent(self, item: Any) -> None:
        """Adds an item that ends the wait at once. From any thread, or a signal handler."""
        self._queue.put(_Urgent(item))

    def get(self, timeout_s: float | None, enough: int) -> Any:
        """One item; as ``get_all`` if none is left of what that returned, else at once."""
        if not self._rest:
            self._rest = self._take(timeout_s, enough)
        return self._rest.pop(0) if self._rest else None

    def get_all(self, timeout_s: float | None, enough: int) -> list[Any]:
        """All that is there, oldest first but for the quiet before the others, once it is enough or urgent.

        Args:
            timeout_s: Wall seconds after which whatever there is will do. 0: at once. None: never.
            enough: How many must be there, the quiet not counted; at least 1.
        """
        if self._rest:
            rest, self._rest = self._rest, []
            return rest + self._take(0, 1)
        return self._take(timeout_s, enough)

    def _take(self, timeout_s: float | None, enough: int) -> list[Any]:
        items: list[Any] = []
        take, empty = self._queue.get, self._queue.empty
        until = None if timeout_s is None else time.monotonic() + timeout_s
        left = timeout_s
        try:
            while len(items) < enough or not empty():
                item = take(left != 0, left)
                if type(item) is _Urgent:
                    item, enough = item.item, 0
                items.append(item)
                if until is not None:
                    left = max(until - time.monotonic(), 0.0)
        except queue.Empty:
            pass  # the time is up
        return [item for source in self.quiet for item in iter(source, None)] + items
