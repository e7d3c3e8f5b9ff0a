"""Events of compilation."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from numba.core import event


class _Listener(event.Listener):
    """Listener to numba's compiler: a function's callees are compiled within the function."""

    def __init__(self, on_start: Callable[[str, int], None]) -> None:
        self._on_start = on_start
        self._depth = 0
        self.entries = 0

    def on_start(self, event: event.Event) -> None:
        """Tell of a function that begins."""
        self._on_start(event.data["dispatcher"].py_func.__name__, self._depth)
        self._depth += 1

    def on_end(self, _event: event.Event) -> None:
        """Count an entry point that is done."""
        self._depth -= 1
        self.entries += self._depth == 0


@contextmanager
def listening(on_start: Callable[[str, int], None]) -> Iterator[Callable[[], int]]:
    """Call ``on_start`` for each function that is compiled in here, not for those loaded.

    Args:
        on_start: takes the function's name, and how many others wait for it: none for an entry point.

    Yields:
        A function that returns how many entry points have been compiled in here.
    """
    listener = _Listener(on_start)
    event.register("numba:compile", listener)
    try:
        yield lambda: listener.entries
    finally:
        event.unregister("numba:compile", listener)
