"""Starting worker processes, hearing of their failures, and ending every one of them.

The processes are forked by a nursery (`deploy.workers.forkserver`). Ending is by process, never by name: ask (over the
bus, the caller's part), wait, SIGTERM, wait, SIGKILL. Should this process itself be killed, the nursery and
every worker notice at once and end.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from socket import socketpair
from types import TracebackType
from typing import Any, Self, final

from deploy.errors import DeployError

_NURSERY = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from deploy.workers.forkserver import main; main(int(sys.argv[2]), int(sys.argv[3]), json.loads(sys.argv[4]))"
)

_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""A worker's arrays are small: pools of threads would cost memory in each and gain nothing."""

_PROGRAM = "FirmwareFailed"
"""Kind of the failure of a cell's program."""

_PATIENCE_S = 2.0
"""How long each step of ending a worker by signals may take."""


class WorkerError(DeployError):
    """A worker process could not do its work."""


@dataclass(frozen=True, slots=True)
class Failure:
    """A worker that raised.

    Attributes:
        worker: Its number.
        error: What was wrong, one line.
        kind: Name of the exception's class.
        detail: The traceback.
    """

    worker: int
    error: str
    kind: str
    detail: str


@final
class WorkerPool:
    """The worker processes of one run, started through a nursery and ended in `close`.

    Args:
        preload: Modules that every worker needs: imported once, before the first fork.
        environment: Environment of the workers; default: this process's own.

    Attributes:
        pids: Process id by worker, of those that have been started and have not ended.
        ended: Exit status by worker, minus the signal's number where a signal ended it.
        failures: What workers raised, in order of arrival.
        gone: Whether every process has gone that could report anything, the nursery too.
    """

    def __init__(self, preload: Sequence[str] = (), environment: dict[str, str] | None = None) -> None:
        self.pids: dict[int, int] = {}
        self.ended: dict[int, int] = {}
        self.failures: list[Failure] = []
        self._names: dict[int, str] = {}
        self._replaced: Counter[int] = Counter()
        """Ends that are still to be told of workers that have been started anew."""
        self._unread = b""
        self.pipe_closed = False
        ours, theirs = socketpair()
        reading, writing = os.pipe()
        self._channel = Connection(ours.detach())
        self._reports = reading
        os.set_blocking(reading, False)
        environment = {**dict.fromkeys(_ONE_THREAD, "1"), **(environment or os.environ)}
        arguments = [json.dumps(sys.path), str(theirs.fileno()), str(writing), json.dumps(list(preload))]
        try:
            self._nursery = subprocess.Popen(
                [sys.executable, "-c", _NURSERY, *arguments],
                stdin=subprocess.DEVNULL,
                stdout=2,  # a firmware that prints must not spoil what the command prints
                env=environment,
                pass_fds=(theirs.fileno(), writing),
                start_new_session=True,  # Ctrl-C in the terminal is for the main process alone
            )
        except OSError as error:
            self._channel.close()
            os.close(reading)
            raise WorkerError(f"cannot start a process: {error.strerror}") from error
        finally:
            theirs.close()
            os.close(writing)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def start(self, order: Callable[[int], None], names: Sequence[str]) -> None:
        """Fork one worker a name; each calls ``order`` with its number and ends when that returns.

        Args:
            order: Picklable; what it refers to must be importable in the workers.
            names: Names shown in process lists and messages; a worker's number is its place here.
        """
        self._names = dict(enumerate(names))
        self._send("order", order)
        self._send("start", list(enumerate(names)))

    def add(self, name: str) -> int:
        """Fork one more worker, which does what all do; returns its number.

        Raises:
            WorkerError: The process that starts workers has ended.
        """
        worker = len(self._names)
        self._names[worker] = name
        self._send("start", [(worker, name)])
        return worker

    def signal(self, number: int, workers: Sequence[int]) -> None:
        """Send a signal to workers; those that have ended are left out."""
        self._send("signal", (number, list(workers)))

    def restart(self, order: Callable[[int], None], worker: int) -> None:
        """Fork a worker anew, that which has its number being ended first."""
        while self.poll():
            pass
        with contextlib.suppress(WorkerError):  # nobody can be started any more: it stays away
            if self.ended.pop(worker, None) is None:
                self.signal(signal.SIGKILL, [worker])
                self._replaced[worker] += 1
            self._send("order", order)
            self._send("start", [(worker, self._names[worker])])

    def _send(self, what: str, content: object) -> None:
        try:
            self._channel.send((what, content))
        except (BrokenPipeError, ConnectionResetError) as error:
            self.poll(_PATIENCE_S)
            raise WorkerError(
                f"the process that starts workers ended early, with status {self._nursery.poll()}"
            ) from error

    def name(self, worker: int) -> str:
        """The worker's name, as given to `start`."""
        return self._names[worker]

    @property
    def running(self) -> list[int]:
        """Workers that have not ended, those not yet known to be started included."""
        return [] if self.pipe_closed else [worker for worker in self._names if worker not in self.ended]

    def poll(self, timeout_s: float = 0.0) -> bool:
        """Take in what has been reported, waiting for something up to ``timeout_s``; False if nothing was."""
        if self.pipe_closed or not _readable(self._reports, timeout_s):
            return False
        content = os.read(self._reports, 1 << 20)
        if not content:  # every process that could report has gone
            os.close(self._reports)
            self.pipe_closed = True
            self.pids.clear()
            return True
        *lines, self._unread = (self._unread + content).split(b"\n")
        for line in lines:
            self._take(json.loads(line))
        return True

    def _take(self, event: dict[str, Any]) -> None:
        worker = int(event["worker"])
        match event["event"]:
            case "started":
                self.pids[worker] = int(event["pid"])
            case "ended" if self._replaced[worker]:
                self._replaced[worker] -= 1  # the one before
            case "ended":
                self.pids.pop(worker, None)
                self.ended[worker] = int(event["status"])
            case "failed":
                self.failures.append(
                    Failure(worker, event["error"], event.get("kind", "OSError"), event["detail"])
                )
            case other:
                raise AssertionError(f"this is a bug: a worker reported {other!r}")

    def check(self) -> None:
        """Raise WorkerError if a worker has failed or ended, or if the nursery has."""
        while self.poll():
            pass
        if self.failures:
            failure = self.messages()[0]
            raise WorkerError(f"{self.name(failure.worker)}: {failure.error}")
        for worker, status in self.ended.items():
            raise WorkerError(f"{self.name(worker)} ended before the run did: {describe_exit(status)}")
        if self.pipe_closed:
            raise WorkerError("the process that starts workers ended before the run did")

    def messages(self) -> list[Failure]:
        """The failures in the order to tell them: programs that failed first, then by worker.

        Workers are numbered as their cells, so the program that is named does not depend on which worker was faster.
        """
        return sorted(self.failures, key=lambda failure: (failure.kind != _PROGRAM, failure.worker))

    @property
    def programs_failed(self) -> bool:
        """Whether programs that failed are all that has gone wrong, and some have."""
        failed = {failure.worker for failure in self.failures if failure.kind == _PROGRAM}
        return (
            not self.pipe_closed and len(failed) == len(self.failures) > 0 and failed.issuperset(self.ended)
        )

    def wait(self, timeout_s: float) -> bool:
        """Wait until every worker has ended; False if some still run after ``timeout_s``."""
        deadline = time.monotonic() + timeout_s
        while self.running:
            left = deadline - time.monotonic()
            if left <= 0:
                return False
            self.poll(left)
        return True

    def close(self, grace_s: float = 0.0) -> None:
        """End every worker and the nursery: wait ``grace_s``, then SIGTERM, then SIGKILL."""
        if self._channel.closed:
            return
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            for number in (signal.SIGTERM, signal.SIGKILL):
                if not self.wait(grace_s):
                    self._channel.send(("signal", (number, self.running)))
                    grace_s = _PATIENCE_S
            self.wait(grace_s)
        self._channel.close()  # the nursery, and whoever is left, end by themselves
        try:
            self._nursery.wait(_PATIENCE_S)
        except subprocess.TimeoutExpired:
            self._nursery.kill()
            self._nursery.wait()
        if not self.pipe_closed:
            while self.poll():
                pass
        if not self.pipe_closed:  # a process started by a firmware may hold the pipe open
            os.close(self._reports)
            self.pipe_closed = True


def describe_exit(status: int) -> str:
    """Say how a process ended, from its exit status or minus the number of the signal."""
    if status >= 0:
        return f"exit status {status}"
    try:
        return f"killed by {signal.Signals(-status).name}"
    except ValueError:
        return f"killed by signal {-status}"


def _readable(fd: int, timeout_s: float) -> bool:
    watch = select.poll()
    watch.register(fd, select.POLLIN)
    return bool(watch.poll(max(0.0, timeout_s) * 1000))
