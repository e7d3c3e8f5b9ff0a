"""Worker processes are started, heard of, and ended, every one of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path
from socket import socketpair

import pytest

from bus.errors import CoordinatorLostError
from cell_firmware.errors import FirmwareFailed
from deploy.workers.pool import WorkerError, WorkerPool, describe_exit
from tests.deploy.workers import forked


def _until_started(crew: WorkerPool, workers: int) -> None:
    deadline = time.monotonic() + 20.0
    while len(crew.pids) + len(crew.ended) < workers:
        assert time.monotonic() < deadline
        crew.poll(1.0)


def _state(pid: int) -> str:
    stat = Path(f"/proc/{pid}/stat")
    return stat.read_text().rpartition(")")[2].split()[0] if stat.exists() else "gone"


def _gone(pid: int) -> bool:
    return _state(pid) in ("gone", "Z")


def test_a_worker_ends_when_its_order_returns() -> None:
    with WorkerPool() as crew:
        crew.start(time.sleep, ["only"])  # worker 0 sleeps 0 s
        assert crew.wait(20.0)
        assert crew.ended == {0: 0}
        assert crew.failures == []


def test_every_worker_is_called_with_its_own_number() -> None:
    with WorkerPool() as crew:
        crew.start(os._exit, ["zero", "one", "two"])
        assert crew.wait(20.0)
        assert crew.ended == {0: 0, 1: 1, 2: 2}


@pytest.mark.skipif(sys.platform != "linux", reason="scheduling policies are Linux's")
def test_workers_interrupt_nothing_unless_another_policy_was_chosen() -> None:
    found = dict[int, int]()

    def look(policy: int) -> None:
        os.sched_setscheduler(0, policy, os.sched_param(0))  # of this thread, and of what it starts
        with WorkerPool() as crew:
            crew.start(forked.exit_with_policy, ["only"])
            assert crew.wait(20.0)
            found[policy] = crew.ended[0]

    for policy in (os.sched_getscheduler(0), os.SCHED_IDLE):
        thread = threading.Thread(target=look, args=(policy,))
        thread.start()
        thread.join()
    assert found.pop(os.SCHED_IDLE) == os.SCHED_IDLE
    assert set(found.values()) == {os.SCHED_BATCH}


def test_a_worker_that_raises_is_reported_with_one_line_and_its_traceback() -> None:
    with WorkerPool() as crew:
        crew.start(partial(divmod, 1), ["cells 0"])
        assert crew.wait(20.0)
        (failure,) = crew.failures
        assert (failure.worker, failure.kind) == (0, "ZeroDivisionError")
        assert failure.detail.startswith("Traceback")
        with pytest.raises(WorkerError, match=r"^cells 0: .*zero$"):
            crew.check()


def _fail_as_firmware(worker: int) -> None:
    raise FirmwareFailed((3, 4), 0, "init: KeyError: 'x'", f"Traceback of worker {worker}\nKeyError: 'x'\n")


def test_of_a_firmware_that_fails_the_line_is_said_once_and_its_own_traceback_shown() -> None:
    with WorkerPool() as crew:
        crew.start(_fail_as_firmware, ["cells 0"])
        assert crew.wait(20.0)
        (failure,) = crew.failures
        assert failure.error == "firmware of cell 3,4 failed in tick 0: init: KeyError: 'x'"
        assert failure.detail == f"{failure.error}\nTraceback of worker 0\nKeyError: 'x'\n"


def _lose_the_plant(worker: int) -> None:
    raise CoordinatorLostError(f"the plant left; shard {worker} waited for tick 7")


def test_a_worker_that_lost_its_plant_has_no_traceback() -> None:
    with WorkerPool() as crew:
        crew.start(_lose_the_plant, ["cells 0"])
        assert crew.wait(20.0)
        (failure,) = crew.failures
        assert failure.detail == failure.error == "the plant left; shard 0 waited for tick 7"


def test_a_worker_that_is_killed_is_reported_with_the_signal() -> None:
    with WorkerPool() as crew:
        crew.start(_sleep_long, ["sleeper"])
        _until_started(crew, 1)
        os.kill(crew.pids[0], signal.SIGKILL)
        assert crew.wait(20.0)
        assert crew.ended[0] == -signal.SIGKILL
        with pytest.raises(WorkerError, match=r"killed by SIGKILL"):
            crew.check()


def test_closing_ends_workers_that_go_on_and_their_parent() -> None:
    crew = WorkerPool()
    crew.start(_sleep_long, ["one", "two"])
    _until_started(crew, 2)
    pids = list(crew.pids.values())
    crew.close()
    assert set(crew.ended.values()) == {-signal.SIGTERM}
    assert all(_gone(pid) for pid in pids)
    crew.close()  # a second time is harmless


def test_a_stopped_worker_is_killed_in_the_end() -> None:
    crew = WorkerPool()
    crew.start(_sleep_long, ["stopped"])
    _until_started(crew, 1)
    pid = crew.pids[0]
    os.kill(pid, signal.SIGSTOP)
    deadline = time.monotonic() + 10.0
    while _state(pid) != "T" and time.monotonic() < deadline:
        crew.poll(0.01)  # a signal sent before it has stopped would be served first
    crew.close()
    assert crew.ended == {0: -signal.SIGKILL}
    assert _gone(pid)


def test_workers_show_their_names_and_share_a_parent() -> None:
    with WorkerPool() as crew:
        crew.start(_tell_name_and_parent, ["cell 0,0", "cell 0,1"])
        assert crew.wait(20.0)
        told = sorted(failure.error.split("/") for failure in crew.failures)
        assert [name for name, _ in told] == ["cell 0,0", "cell 0,1"]
        assert len({parent for _, parent in told}) == 1
        assert told[0][1] != str(os.getpid())


@pytest.mark.skipif(sys.platform != "linux", reason="other systems have no signal for a parent's death")
def test_a_worker_ends_with_the_fork_server(tmp_path: Path) -> None:
    report = tmp_path / "pid"
    with WorkerPool() as crew:
        crew.start(forked.KillParent(str(report)), ["only"])
        deadline = time.monotonic() + 20.0
        while not crew.pipe_closed and time.monotonic() < deadline:  # the worker holds its other end
            crew.poll(0.1)
        assert crew.pipe_closed
        while not _gone(int(report.read_text())) and time.monotonic() < deadline:
            time.sleep(0.01)
        assert _gone(int(report.read_text()))


def test_a_worker_that_watches_the_socket_ends_with_the_main_process() -> None:
    ours, theirs = socketpair()
    code = "import sys; from deploy.workers.forkserver import _die_with; _die_with(int(sys.argv[1]))"
    with (
        ours,
        subprocess.Popen(
            [sys.executable, "-c", code, str(theirs.fileno())], pass_fds=[theirs.fileno()]
        ) as worker,
    ):
        theirs.close()
        ours.close()
        assert worker.wait(20.0) == -signal.SIGKILL


def test_exit_statuses_are_put_in_words() -> None:
    assert [describe_exit(status) for status in (0, 3, -9, -15)] == [
        "exit status 0",
        "exit status 3",
        "killed by SIGKILL",
        "killed by SIGTERM",
    ]


def _sleep_long(worker: int) -> None:
    time.sleep(60.0)


def _tell_name_and_parent(worker: int) -> None:
    raise RuntimeError(f"{Path('/proc/self/comm').read_text().strip()}/{os.getppid()}")
