"""Threads that share the work of one call: all of it is done, once, and nobody works on after the call."""

from __future__ import annotations

import gc
import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from plant.solvers.thread_pool import ThreadPool

ROOT = Path(__file__).resolve().parents[3]
PATIENCE_S = 20.0


def _helpers() -> set[threading.Thread]:
    """Helpers' threads that are alive in this process, those of other tests' pools included."""
    return {thread for thread in threading.enumerate() if thread.name.startswith("mdms-parcels")}


@pytest.mark.parametrize("threads", [1, 2, 3, 7])
@pytest.mark.parametrize("count", [0, 1, 9, 100, 101])
def test_each_range_is_computed_once_and_returned_in_order(threads: int, count: int) -> None:
    shares = ThreadPool(threads).map_ranges(count, lambda _, share: list(range(count))[share], 5)
    assert [k for share in shares for k in share] == list(range(count))
    assert all(len(share) >= min(5, count) for share in shares)


def test_what_is_worth_no_waking_is_done_by_the_caller_alone() -> None:
    pool, before = ThreadPool(4), _helpers()
    shares = pool.map_ranges(15, lambda thread, _: (thread, threading.get_ident()), 8)
    assert shares == [(0, threading.get_ident())]
    assert _helpers() <= before


def test_threads_work_at_the_same_time_and_each_under_its_own_number() -> None:
    pool = ThreadPool(3)
    meeting = threading.Barrier(3)

    def meet(thread: int, _: slice) -> tuple[int, int]:
        # passes only when three threads are in it at once; twelve shares are four rounds of that
        meeting.wait(PATIENCE_S)
        return thread, threading.get_ident()

    met = pool.map_ranges(12, meet, 1)
    assert {thread for thread, _ in met} == {0, 1, 2}
    assert len(set(met)) == 3


def test_helpers_end_with_their_pool() -> None:
    pool, before = ThreadPool(2), _helpers()
    pool.map_ranges(4, lambda *_: None, 1)
    (helper,) = _helpers() - before
    del pool
    gc.collect()
    helper.join(PATIENCE_S)
    assert not helper.is_alive()


def test_what_a_helper_raises_reaches_the_caller() -> None:
    begun = threading.Event()

    def fail(thread: int, _: slice) -> None:
        if thread == 1:
            begun.set()
            raise ValueError("what went wrong")
        begun.wait(PATIENCE_S)

    with pytest.raises(ValueError, match="what went wrong"):
        ThreadPool(2).map_ranges(8, fail, 1)


def test_an_interrupted_caller_leaves_nobody_at_work_and_nothing_begun_behind() -> None:
    begun, raised = threading.Event(), threading.Event()
    ended: list[int] = []

    def work(thread: int, share: slice) -> None:
        if thread == 0:
            begun.wait(PATIENCE_S)
            threading.Timer(0.05, raised.set).start()
            raise KeyboardInterrupt
        begun.set()
        raised.wait(PATIENCE_S)
        ended.append(share.start)

    with pytest.raises(KeyboardInterrupt):
        ThreadPool(2).map_ranges(8, work, 1)
    assert len(ended) == 1


FORKED = """
import os, sys
from plant.solvers.thread_pool import ThreadPool
pool = ThreadPool(2)
assert pool.map_ranges(4, lambda _, share: share.start, 1) == [0, 1, 2, 3]
child = os.fork()
done = pool.map_ranges(4, lambda _, share: share.start, 1)
if child == 0:
    os._exit(0 if done == [0, 1, 2, 3] else 3)
_, status = os.waitpid(child, 0)
sys.exit(os.waitstatus_to_exitcode(status))
"""


@pytest.mark.skipif(not hasattr(os, "fork"), reason="no fork here")
def test_a_forked_process_has_helpers_of_its_own() -> None:
    done = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", FORKED], cwd=ROOT, timeout=PATIENCE_S, check=False
    )
    assert done.returncode == 0
