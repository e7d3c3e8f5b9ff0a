"""Runs of a campaign in worker processes of this machine."""

from __future__ import annotations

import contextlib
import itertools
import signal
import socket
import threading
import time
import traceback
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self, final

from deploy.studies.campaign.result import CaseRecord, run_case
from deploy.workers.pool import WorkerError, WorkerPool, describe_exit
from deploy.workers.socket_folder import SocketFolder

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene


PRELOAD = (
    "asyncio",
    "msgpack",
    "numpy",
    "bus.lockstep",
    "bus.transports.memory",
    "cell_firmware.agent",
    "cell_firmware.build",
    "deploy.studies.campaign.pool",
    "deploy.runs.headless",
    "plant.kernels.exact.block",
    "plant.plant",
    "plant.process",
)
"""What a worker needs: imported once, before the workers are forked. Importing kernels neither compiles
nor runs one."""

_CELLS = "cells"
"""Name of the thread in which a run's cells are."""


@final
@dataclass(frozen=True, slots=True)
class WorkerLoop:
    """Main loop of a worker: runs scenes until the connection closes.

    Args:
        address: Path of the socket from which scenes are received.
        check: Whether runs check the invariants of their programs.
    """

    address: str
    check: bool = False

    def __call__(self, worker: int) -> None:
        """Run scenes; ``worker`` is this one's number."""
        line = socket.socket(socket.AF_UNIX)
        line.connect(self.address)
        with Connection(line.detach()) as connection:
            connection.send(worker)
            while True:
                try:
                    scene: Scene = connection.recv()
                except (EOFError, ConnectionResetError):
                    return
                ending = _run(scene, check=self.check)
                # A firmware that never returns would slow down what runs here next: another process does that.
                spent = any(thread.name == _CELLS for thread in threading.enumerate())
                connection.send((ending, spent))
                if spent:
                    return


def _run(scene: Scene, *, check: bool) -> CaseRecord:
    try:
        return run_case(scene, check=check)
    except Exception as error:  # noqa: BLE001 - whatever it is, it is how this run ended, and the others go on
        where = traceback.extract_tb(error.__traceback__)[-1]
        return CaseRecord(status="failed", reason=f"{error!r} ({where.filename}, line {where.lineno})")


_POLL_S = 0.02
"""Interval at which the limit, signals and workers that never came are checked."""

_MOST_FAILED_STARTS = 3
"""Workers that may end before they come, one after another."""

_REPORT_S = 2.0
"""How long to wait for how a worker ended that has gone."""


class Executor(Protocol):
    """Executor of scenes, local or remote."""

    def map(self, scenes: Iterable[Scene]) -> Iterator[tuple[int, CaseRecord]]:
        """Run scenes; how each ended comes with its place among them, in any order.

        A run that fails, hangs or is killed ends as failed, and the others go on.
        """
        ...


@final
@dataclass(slots=True)
class _Job:
    """Run that is queued or in progress.

    Attributes:
        place: Among the scenes that were given.
        scene: What runs.
        since: Wall time at which it was handed out.
        tried: Whether a worker was lost over it.
    """

    place: int
    scene: Scene
    since: float = 0.0
    tried: bool = False


@final
@dataclass(slots=True)
class _WorkerSlot:
    """Connected worker and its current job.

    Attributes:
        worker: Number of the worker.
        connection: Connection to the worker.
        job: Job in progress; None: idle.
    """

    worker: int
    connection: Connection
    job: _Job | None = None


@final
class ExecutorPool:
    """Pool of worker processes, each with one run at a time; leaving the context terminates all workers.

    They are forked by a fork server, which runs nothing itself, and end with this process however that ends.

    Args:
        jobs: Runs at a time.
        limit_s: Wall time of a run, after which it is ended.
        poll: Called many times a second; may raise.
        check: Whether runs check the invariants of their programs.
    """

    def __init__(self, jobs: int, limit_s: float, poll: Callable[[], None], *, check: bool = False) -> None:
        self._jobs = jobs
        self._limit_s = limit_s
        self._poll = poll
        self._slots: list[_WorkerSlot] = []
        self._coming: set[int] = set()
        """Workers that were started and have not come yet."""
        self._failed_starts = 0
        """Workers that ended before they came, since the last that did come."""
        with contextlib.ExitStack() as stack:
            address = str(stack.enter_context(SocketFolder()).path / "workers")
            self._listener = stack.enter_context(socket.socket(socket.AF_UNIX))
            self._listener.bind(address)
            self._listener.listen(jobs)
            self._workers = stack.enter_context(WorkerPool(PRELOAD))
            self._workers.start(WorkerLoop(address, check), ())
            stack.callback(self._dismiss)
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def _dismiss(self) -> None:
        """Workers that wait for a scene end by themselves."""
        for slot in self._slots:
            slot.connection.close()

    def map(self, scenes: Iterable[Scene]) -> Iterator[tuple[int, CaseRecord]]:
        """Run scenes; see `Executor`.

        Raises:
            WorkerError: No worker can be started.
        """
        more = (_Job(place, scene) for place, scene in enumerate(scenes))
        todo = deque(itertools.islice(more, self._jobs))
        while todo or any(slot.job for slot in self._slots):
            self._poll()
            self._scale_up(len(todo))
            self._hand_out(todo)
            ready = wait([self._listener, *(slot.connection for slot in self._slots)], _POLL_S)
            if self._listener in ready:
                self._accept()
            for slot in [slot for slot in self._slots if slot.connection in ready]:
                yield from self._receive(slot, todo)
            yield from self._overdue()
            todo.extend(itertools.islice(more, max(0, self._jobs - len(todo))))

    def _scale_up(self, todo: int) -> None:
        """Start workers up to the number of queued runs, at most the requested number."""
        while self._workers.poll():
            pass
        if self._workers.pipe_closed:
            raise WorkerError("the process that starts workers has ended")
        for worker in [worker for worker in self._coming if worker in self._workers.ended]:
            self._coming.discard(worker)
            self._failed_starts += 1
            if self._failed_starts > _MOST_FAILED_STARTS:
                why = next((one.error for one in self._workers.failures if one.worker == worker), "")
                raise WorkerError(
                    "worker processes end before their first run: "
                    f"{why or describe_exit(self._workers.ended[worker])}"
                )
        busy = sum(slot.job is not None for slot in self._slots)
        wanted = min(self._jobs, busy + todo) - len(self._slots) - len(self._coming)
        for _ in range(wanted):
            self._coming.add(self._workers.add("mdms campaign"))

    def _accept(self) -> None:
        line = Connection(self._listener.accept()[0].detach())
        try:
            worker: int = line.recv()
        except (EOFError, ConnectionResetError):
            line.close()  # its end is reported, too
            return
        self._coming.discard(worker)
        self._failed_starts = 0
        self._slots.append(_WorkerSlot(worker, line))

    def _hand_out(self, todo: deque[_Job]) -> None:
        for slot in self._slots:
            if slot.job is None and todo:
                slot.job = todo.popleft()
                slot.job.since = time.monotonic()
                # A worker that has gone is noticed in the next turn.
                with contextlib.suppress(BrokenPipeError, ConnectionResetError):
                    slot.connection.send(slot.job.scene)

    def _receive(self, slot: _WorkerSlot, todo: deque[_Job]) -> Iterator[tuple[int, CaseRecord]]:
        """Receive a worker's result, or handle the loss of the worker."""
        job, slot.job = slot.job, None
        try:
            reply: tuple[CaseRecord, bool] = slot.connection.recv()
        except (EOFError, ConnectionResetError):
            self._release(slot)
            if job is not None:
                yield from self._lost(slot.worker, job, todo)
            return
        assert job is not None
        ending, spent = reply
        if spent:
            self._release(slot)
        yield job.place, ending

    def _lost(self, worker: int, job: _Job, todo: deque[_Job]) -> Iterator[tuple[int, CaseRecord]]:
        """Requeue the job of a lost worker, or fail the job at the second loss."""
        if job.tried:
            reason = f"its process was lost twice: {self._how(worker)}"
            yield job.place, CaseRecord(status="failed", reason=reason)
        else:
            job.tried = True
            todo.appendleft(job)

    def _release(self, slot: _WorkerSlot) -> None:
        """Nothing more is handed to a worker, which ends by itself."""
        self._slots.remove(slot)
        slot.connection.close()

    def _how(self, worker: int) -> str:
        """Describe how a worker ended."""
        deadline = time.monotonic() + _REPORT_S
        while worker not in self._workers.ended and (left := deadline - time.monotonic()) > 0.0:
            self._workers.poll(left)
        return (
            describe_exit(self._workers.ended[worker])
            if worker in self._workers.ended
            else "for an unknown reason"
        )

    def _overdue(self) -> Iterator[tuple[int, CaseRecord]]:
        """End what takes longer than it may."""
        now = time.monotonic()
        for slot in list(self._slots):
            if slot.job is not None and now - slot.job.since > self._limit_s:
                self._workers.signal(signal.SIGKILL, [slot.worker])
                self._release(slot)
                yield (
                    slot.job.place,
                    CaseRecord(status="failed", reason=f"not over after {self._limit_s:g} s (--limit)"),
                )
