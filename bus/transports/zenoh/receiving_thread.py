"""Python state of Zenoh's receiving threads."""

from __future__ import annotations

import ctypes
import os
import threading
from collections.abc import Callable
from typing import Any

import zenoh

_held: set[int] = set()
"""Receiving threads that keep their Python state."""
os.register_at_fork(after_in_child=_held.clear)  # those threads are not in the child


def keep_state(call: Callable[[zenoh.Sample], None]) -> Callable[[zenoh.Sample], Any]:
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
