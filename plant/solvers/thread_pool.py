"""Thread pool that distributes a call's parcels.

Kernels release the interpreter lock while they run (``nogil``), so plain threads suffice. Unlike numba's own threads,
plain threads leave no state behind that prevents a process from forking.
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import TypeVar, final

Done = TypeVar("Done")

TURNS = 4
"""How many shares a thread gets on average: parcels differ in cost, and who is done early takes from the rest."""


def processors() -> int:
    """Return the number of processors available to this process."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@final
class ThreadPool:
    """Calling thread and helper threads, started on demand and stopped with the pool.

    Results must not depend on which thread computes a share: free threads take the next share.

    Args:
        threads: maximum number of threads including the calling one; None: one a processor.
    """

    def __init__(self, threads: int | None = None) -> None:
        self.threads: int = threads or processors()
        self._pool: ThreadPoolExecutor | None = None
        self._process = 0

    def map_ranges(self, count: int, do: Callable[[int, slice], Done], least: int) -> list[Done]:
        """Have ``range(count)`` done in shares.

        Args:
            count: how many there are.
            do: called with the thread's number, from 0, and the share; never twice at once for one thread.
            least: a share is no smaller, and for fewer than two of them nobody is woken.

        Returns:
            What ``do`` returned, in the order of the shares.
        """
        threads = min(self.threads, count // least)
        if threads < 2:
            return [do(0, slice(0, count))]
        shares = min(TURNS * threads, count // least)
        todo = deque(range(shares))
        done: dict[int, Done] = {}

        def labour(thread: int) -> None:
            while True:
                try:
                    share = todo.popleft()
                except IndexError:
                    return
                done[share] = do(thread, slice(share * count // shares, (share + 1) * count // shares))

        helpers = [self._helpers().submit(labour, thread) for thread in range(1, threads)]
        try:
            labour(0)
            for helper in helpers:
                helper.result()
        finally:
            # whatever happened, nobody goes on changing parcels behind the caller's back
            todo.clear()
            wait(helpers)
        return [done[share] for share in range(shares)]

    def _helpers(self) -> ThreadPoolExecutor:
        """The helpers' threads; a forked process has none of its parent's, and starts its own."""
        if self._pool is None or self._process != os.getpid():
            self._pool = ThreadPoolExecutor(self.threads - 1, thread_name_prefix="mdms-parcels")
            self._process = os.getpid()
        return self._pool
