"""Fork server: the clean parent of worker processes.

A process that has opened a Zenoh session or run a compiled kernel must not be forked. Workers are therefore
forked from a small separate process that only imports modules. The fork server receives commands over a socket and
reports events over a pipe, one line of JSON an event:

    {"worker": 3, "event": "started", "pid": 4711}
    {"worker": 3, "event": "failed", "error": "...", "detail": "the traceback"}
    {"worker": 3, "event": "ended", "status": -9}

When the socket's other end closes for any reason, the fork server kills its workers and ends. Linux kills the workers
when the fork server ends for any reason. Elsewhere the workers watch the socket too. No worker outlives the main
process or the fork server.
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import json
import os
import select
import selectors
import signal
import sys
import threading
import traceback
from collections.abc import Callable, Iterable
from multiprocessing.connection import Connection
from types import FrameType
from typing import Any, final

Order = Callable[[int], None]
"""Function of a worker, called with the worker's number; raises on failure."""

Prepare = Callable[[Any], Order]
"""Function that is called once with an order, before its workers are forked. It returns the order that they get."""

_LIBC: ctypes.CDLL | None = ctypes.CDLL(None) if sys.platform == "linux" else None
_PR_SET_PDEATHSIG = 1
"""Of the Linux kernel's ``prctl``."""

_LINE_LIMIT = select.PIPE_BUF
"""Longest line that is written to a pipe atomically."""


def main(channel_fd: int, report_fd: int, preload: Iterable[str]) -> None:
    """Serve commands until the socket ``channel_fd`` closes."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    gc.disable()  # nearly all objects of imports stay
    for name in preload:
        importlib.import_module(name)
    gc.freeze()
    _ForkServer(Connection(channel_fd), report_fd).serve()
    os._exit(0)  # the main process waits for this end


@final
class _ForkServer:
    def __init__(self, channel: Connection, report_fd: int) -> None:
        self._channel = channel
        self._report_fd = report_fd
        self._order: Order | None = None
        self._pid = os.getpid()
        self._workers: dict[int, int] = {}
        """Number of each worker, by process id."""
        self._wakeup = os.pipe()
        for fd in self._wakeup:
            os.set_blocking(fd, False)
        signal.signal(signal.SIGCHLD, _noticed)
        signal.set_wakeup_fd(self._wakeup[1], warn_on_full_buffer=False)

    def serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            selector.register(self._channel, selectors.EVENT_READ)
            selector.register(self._wakeup[0], selectors.EVENT_READ)
            while True:
                for key, _ in selector.select():
                    if key.fd == self._wakeup[0]:
                        os.read(self._wakeup[0], 4096)
                        self._reap()
                    elif not self._handle():
                        self._end()
                        return

    def _handle(self) -> bool:
        """Handle one command; False once the socket is closed."""
        try:
            message: tuple[str, Any] = self._channel.recv()
        except (EOFError, ConnectionError):
            return False
        match message:
            case "order", (order, prepare):
                self._order = order if prepare is None else _prepared(order, prepare)
            case "start", workers:
                for worker, name in workers:
                    self._start(worker, name)
            case "signal", (number, workers):
                self._signal(number, set(workers))
            case _:
                raise AssertionError(f"this is a bug: the fork server does not know {message!r}")
        return True

    def _start(self, worker: int, name: str) -> None:
        assert self._order is not None, "this is a bug: a worker without an order"
        try:
            pid = os.fork()
        except OSError as error:
            self._report(worker, "failed", error=f"cannot start a process: {error.strerror}", detail="")
            return
        if pid == 0:
            self._work(worker, name, self._order)
        self._workers[pid] = worker
        self._report(worker, "started", pid=pid)

    def _work(self, worker: int, name: str, order: Order) -> None:
        """Run the worker and exit; never returns."""
        status = 1
        try:
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            gc.enable()
            _rename(name)
            _run_in_batch()
            if not _die_with_parent(self._pid):
                watch = threading.Thread(target=_die_with, args=(self._channel.fileno(),), daemon=True)
                watch.start()
            order(worker)
            status = 0
        except BaseException as error:  # noqa: BLE001 - whatever it is, it is told to the main process
            self._report(
                worker,
                "failed",
                error=one_line(error),
                kind=type(error).__name__,
                detail=_told(error),
            )
        finally:
            # No code of the fork server's stack may run in a worker.
            try:
                sys.stdout.flush()
                sys.stderr.flush()
            finally:
                os._exit(status)

    def _report(self, worker: int, event: str, **more: object) -> None:
        content = {"worker": worker, "event": event, **more}
        line = json.dumps(content) + "\n"
        if len(line) > _LINE_LIMIT:
            content["error"] = str(more.get("error", ""))[: _LINE_LIMIT // 8]
            content["detail"] = "... " + str(more.get("detail", ""))[-_LINE_LIMIT // 8 :]
            line = json.dumps(content) + "\n"
        # where the main process has gone, its socket ends all of this
        with contextlib.suppress(BrokenPipeError):
            os.write(self._report_fd, line.encode())

    def _reap(self) -> None:
        while self._workers:
            pid, status = os.waitpid(-1, os.WNOHANG)
            if pid == 0:
                return
            worker = self._workers.pop(pid)
            self._report(worker, "ended", status=os.waitstatus_to_exitcode(status))

    def _signal(self, number: int, workers: set[int]) -> None:
        for pid, worker in self._workers.items():
            if worker in workers:
                os.kill(pid, number)

    def _end(self) -> None:
        for pid in self._workers:
            os.kill(pid, signal.SIGKILL)
        for pid in self._workers:
            os.waitpid(pid, 0)


def _prepared(order: Order, prepare: Prepare) -> Order:
    """Return the order of the workers, prepared once for all of them."""
    try:
        return prepare(order)
    except Exception:  # noqa: BLE001 - each worker meets it again, and reports it as its own
        return order
    finally:
        gc.freeze()


def _noticed(number: int, frame: FrameType | None) -> None:
    """Ignore SIGCHLD; a handler must be set for the wake-up descriptor to wake the selector."""


def _die_with_parent(parent: int) -> bool:
    """Have the system kill this process as soon as its parent has ended; False where the system can't.

    A watching thread would cost each process half a megabyte.
    """
    if _LIBC is None or _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL) != 0:
        return False
    if os.getppid() != parent:  # it ended before
        os.kill(os.getpid(), signal.SIGKILL)
    return True


def _die_with(fd: int) -> None:
    """Kill this process as soon as the main process has ended."""
    watch = select.poll()
    watch.register(fd, 0)  # hang-up alone is reported; messages on the socket are for the fork server
    while not watch.poll():
        pass
    os.kill(os.getpid(), signal.SIGKILL)


def _run_in_batch() -> None:
    """Have this process interrupt no other one when it is woken: a plant that wakes many cells would wait for each.

    A policy that somebody has chosen stays.
    """
    if sys.platform == "linux" and os.sched_getscheduler(0) == os.SCHED_OTHER:
        with contextlib.suppress(OSError):  # forbidden, as in some containers
            os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))


def _rename(name: str) -> None:
    """Show ``name`` in process lists, where the system lets a process name itself."""
    with contextlib.suppress(FileNotFoundError):
        own = os.open("/proc/self/comm", os.O_WRONLY)
        os.write(own, name[:15].encode())
        os.close(own)


def _told(error: BaseException) -> str:
    """Return the traceback; of a firmware failure, only the firmware's own part, of a lost plant one line."""
    from bus.errors import CoordinatorLostError
    from cell_firmware.errors import FirmwareFailed

    return str(error) if isinstance(error, (FirmwareFailed, CoordinatorLostError)) else traceback.format_exc()


def one_line(error: BaseException) -> str:
    """Return the first and the last line of an error's text: the failure and, of a traceback, the cause."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if lines and lines[0].endswith(lines[-1]):
        return lines[0]
    return " ".join(lines[:1] + lines[-1:]) or type(error).__name__
