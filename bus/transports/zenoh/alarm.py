"""A thread that ends waits which know no time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Final, final

PRECISION_S: Final = 0.1


@final
class Alarm:
    """Rings when its time has come, at most ``PRECISION_S`` late, and again until it is put off.

    Args:
        ring: What it does.
    """

    def __init__(self, ring: Callable[[], None]) -> None:
        self._ring = ring
        self._until: float | None = None
        self._thread: threading.Thread | None = None
        self._closed = threading.Event()

    def set(self, until: float | None) -> None:
        """Rings at ``until`` (``time.monotonic``), or not at all."""
        self._until = until
        if self._thread is None:
            self._thread = threading.Thread(target=self._watch, name="alarm", daemon=True)
            self._thread.start()

    def close(self) -> None:
        """Ends the thread."""
        self._closed.set()

    def _watch(self) -> None:
        while not self._closed.wait(PRECISION_S):
            until = self._until
            if until is not None and time.monotonic() >= until:
                self._ring()
