"""Pool of worker processes: start, failure reports and end.

The processes are forked by a fork server (`deploy.workers.forkserver`). A worker is ended by process id, never by name:
a stop request (over the bus, sent by the caller), wait, SIGTERM, wait, SIGKILL. If this process is killed, the fork
server and every worker notice at once and end.
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
from deploy.workers.debugger import terminal_variable
from deploy.workers.forkserver import Prepare

_NURSERY = (
    "import json, sys; sys.path[:] = json.loads(sys.argv[1]); "
    "from deploy.workers.forkserver import main; main(int(sys.argv[2]), int(sys.argv[3]), json.loads(sys.argv[4]))"
)

_ONE_THREAD = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""Thread pools of libraries, limited to one thread: a worker's arrays are small, and threads would only cost memory."""

_PROGRAM = "FirmwareFailed"
"""Kind of failure of a cell's program."""

_PATIENCE_S = 2.0
"""Longest wait after each signal that ends a worker."""


class WorkerError(DeployError):
    """Failure of a worker process."""


@dataclass(frozen=True, slots=True)
class Failure:
    """A worker that raised.

    Attributes:
        worker: Number of the worker.
        error: Error message, one line.
        kind: Name of the exception's class.
        detail: The traceback.
    """

    worker: int
    error: str
    kind: str
    detail: str


@final
class WorkerPool:
    """Worker processes of one run, started through a fork server and ended in `close`.

    Args:
        preload: Modules that every worker needs, imported once before the first fork.
        environment: Environment of the workers; default: this process's own.

    Attributes:
        pids: Process id of each running worker, by worker.
        ended: Exit status of each ended worker, by worker; minus the signal's number if a signal ended the process.
        failures: Failures of workers, in order of arrival.
        pipe_closed: Whether the report pipe is closed: all workers and the fork server have ended.
    """

    def __init__(self, preload: Sequence[str] = (), environment: dict[str, str] | None = None) -> None:
        self.pids: dict[int, int] = {}
        self.ended: dict[int, int] = {}
        self.failures: list[Failure] = []
        self._names: dict[int, str] = {}
        self._replaced: Counter[int] = Counter()
        """Number of ends still to be reported, of workers that have been replaced."""
        self._unread = b""
        self.pipe_closed = False
        ours, theirs = socketpair()
        reading, writing = os.pipe()
        self._channel = Connection(ours.detach())
        self._reports = reading
        os.set_blocking(reading, False)
        environment = {
            **dict.fromkeys(_ONE_THREAD, "1"),
            **(environment or os.environ),
            **terminal_variable(),
        }
        arguments = [json.dumps(sys.path), str(theirs.fileno()), str(writing), json.dumps(list(preload))]
        try:
            self._nursery = subprocess.Popen(
                [sys.executable, "-P", "-c", _NURSERY, *arguments],
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

    def start(
        self, order: Callable[[int], None], names: Sequence[str], prepare: Prepare | None = None
    ) -> None:
        """Fork one worker a name; each calls ``order`` with its number and ends when that returns.

        Args:
            order: Picklable; what it refers to must be importable in the workers.
            names: Names shown in process lists and messages; a worker's number is its place here.
            prepare: Function of a module, called once with the order before the first fork; returns the order of these
                workers. If it raises, they get ``order`` itself. None: they do.
        """
        self._names = dict(enumerate(names))
        self._send("order", (order, prepare))
        self._send("start", list(enumerate(names)))

    def add(self, name: str) -> int:
        """Fork one more worker with the pool's order; return the worker's number.

        Raises:
            WorkerError: The process that starts workers has ended.
        """
        worker = len(self._names)
        self._names[worker] = name
        self._send("start", [(worker, name)])
        return worker

    def signal(self, number: int, workers: Sequence[int]) -> None:
        """Send a signal to workers; ended workers are skipped."""
        self._send("signal", (number, list(workers)))

    def restart(self, order: Callable[[int], None], worker: int) -> None:
        """Replace a worker; a running process of the same number is killed first."""
        while self.poll():
            pass
        with contextlib.suppress(WorkerError):  # no worker can be started any more
            if self.ended.pop(worker, None) is None:
                self.signal(signal.SIGKILL, [worker])
                self._replaced[worker] += 1
            self._send("order", (order, None))
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
        """Return the worker's name, as given to `start`."""
        return self._names[worker]

    @property
    def running(self) -> list[int]:
        """Workers that have not ended, workers without a start report included."""
        return [] if self.pipe_closed else [worker for worker in self._names if worker not in self.ended]

    def poll(self, timeout_s: float = 0.0) -> bool:
        """Handle pending reports, after a wait of up to ``timeout_s``; False if there was no report."""
        if self.pipe_closed or not _readable(self._reports, timeout_s):
            return False
        content = os.read(self._reports, 1 << 20)
        if not content:  # every process that could report has ended
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
                self._replaced[worker] -= 1  # end of the replaced process
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
        """Raise WorkerError if a worker or the fork server has failed or ended."""
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
        """Return the failures in the order of messages: failed programs first, then by worker.

        Workers are numbered as their cells, so that the named program does not depend on the workers' speed.
        """
        return sorted(self.failures, key=lambda failure: (failure.kind != _PROGRAM, failure.worker))

    @property
    def programs_failed(self) -> bool:
        """Whether there are failures, and all of them are failed programs."""
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
        """End every worker and the fork server: wait ``grace_s``, then SIGTERM, then SIGKILL."""
        if self._channel.closed:
            return
        with contextlib.suppress(BrokenPipeError, ConnectionResetError):
            for number in (signal.SIGTERM, signal.SIGKILL):
                if not self.wait(grace_s):
                    self._channel.send(("signal", (number, self.running)))
                    grace_s = _PATIENCE_S
            self.wait(grace_s)
        self._channel.close()  # the fork server and remaining workers end when this closes
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
    """Describe the end of a process, from its exit status or minus the number of the signal."""
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
