"""The cells' side of a run as the plant's process sees it: worker processes, or a thread of this one."""

from __future__ import annotations

import resource
import threading
from typing import Protocol, final

from bus.transports.base import Endpoint
from deploy.workers.forkserver import one_line
from deploy.workers.plan import Plan
from deploy.workers.pool import WorkerError, WorkerPool
from deploy.workers.worker import WorkerConfig, serve

PRELOAD = (
    "asyncio",
    "msgpack",
    "numpy",
    "zenoh",
    "bus.lockstep",
    "bus.transports.zenoh",
    "cell_firmware.agent",
    "cell_firmware.protocols.heat_diffusion",
    "cell_firmware.protocols.hanging_field",
    "cell_firmware.protocols.velocity_field",
    "cell_firmware.protocols.presence_field",
    "deploy.scenes.scene",
    "deploy.workers.worker",
    "plant.array",
)
"""What a worker needs: imported once, before the workers are forked."""

_FILES_A_WORKER = 4
"""Open files that a worker's session costs the plant's process, generously."""


class WorkerGroup(Protocol):
    """Starts the cells, says what went wrong with them, and ends them."""

    def start(self, order: WorkerConfig) -> None:
        """Start every agent; returns before they are ready."""
        ...

    def restart(self, order: WorkerConfig, shard: int) -> None:
        """Start the agents of one shard anew, those that were there being ended first."""
        ...

    def ended(self, shard: int) -> bool:
        """Whether the process of a shard has ended."""
        ...

    def trouble(self, timeout_s: float) -> bool:
        """Whether anything has gone wrong, waiting up to ``timeout_s`` for it."""
        ...

    def programs_failed(self) -> bool:
        """Whether programs that failed are all that has gone wrong, and others may yet fail."""
        ...

    def check(self) -> None:
        """Raise WorkerError if anything has gone wrong."""
        ...

    def details(self) -> str:
        """Tracebacks of what went wrong, or an empty string."""
        ...

    def close(self, grace_s: float) -> None:
        """End every agent; those that were told to stop get ``grace_s`` to do so."""
        ...


@final
class WorkerProcesses:
    """One worker process a shard. Made before anything else, so that it gets ready meanwhile.

    Args:
        plan: Which cells run where.
    """

    def __init__(self, plan: Plan) -> None:
        self._names = [process.name for process in plan.processes if process.role == "cells"]
        self._crew = WorkerPool(PRELOAD)

    def start(self, order: WorkerConfig) -> None:
        """Fork the workers."""
        _allow_files(_FILES_A_WORKER * len(self._names))
        self._crew.start(order, self._names)

    def restart(self, order: WorkerConfig, shard: int) -> None:
        """Fork one worker anew."""
        self._crew.restart(order, shard)

    def ended(self, shard: int) -> bool:
        """Whether it has ended."""
        while self._crew.poll():
            pass
        return shard in self._crew.ended

    def trouble(self, timeout_s: float) -> bool:
        """Whether a worker has failed or ended."""
        self._crew.poll(timeout_s)
        return bool(self._crew.failures or self._crew.ended or self._crew.pipe_closed)

    def programs_failed(self) -> bool:
        """Whether programs that failed are all that has gone wrong."""
        while self._crew.poll():
            pass
        return self._crew.programs_failed

    def check(self) -> None:
        """Raise WorkerError if a worker has failed or ended."""
        self._crew.check()

    def details(self) -> str:
        """Tracebacks of the workers that raised."""
        crew = self._crew
        return "\n".join(f"{crew.name(failure.worker)}: {failure.detail}" for failure in crew.messages())

    def close(self, grace_s: float) -> None:
        """End every worker and their parent."""
        self._crew.close(grace_s)


@final
class WorkerThread:
    """Every agent in the event loop of one thread of this process.

    Args:
        endpoint: The cells' own; closed when they have ended.
    """

    def __init__(self, endpoint: Endpoint) -> None:
        self._endpoint = endpoint
        self._thread: threading.Thread | None = None
        self._error: BaseException | None = None
        self._over = threading.Event()

    def start(self, order: WorkerConfig) -> None:
        """Start the thread."""

        def work() -> None:
            try:
                serve(order, 0, self._endpoint)
            except BaseException as error:  # noqa: BLE001 - whatever it is, `check` raises it
                self._error = error
            finally:
                self._over.set()

        # A firmware that never returns must not keep the process from ending.
        self._thread = threading.Thread(target=work, name="cells", daemon=True)
        self._thread.start()

    def restart(self, order: WorkerConfig, shard: int) -> None:  # noqa: ARG002
        """A thread can't be killed, and need not be started anew."""
        raise AssertionError("this is a bug: there is no process to start anew")

    def ended(self, shard: int) -> bool:  # noqa: ARG002
        """Whether the agents have ended."""
        return self._over.is_set()

    def trouble(self, timeout_s: float) -> bool:
        """Whether the agents have ended, as they don't before they are told to."""
        return self._over.wait(timeout_s)

    def programs_failed(self) -> bool:
        """All programs begin in one call, which names the lowest cell: no other is still to fail."""
        return False

    def check(self) -> None:
        """Raise WorkerError if an agent has raised."""
        if self._error is not None:
            raise WorkerError(f"cells: {one_line(self._error)}") from self._error
        if self._over.is_set():
            raise WorkerError("cells: the agents ended before the run did")

    def details(self) -> str:
        """The traceback, where an agent raised."""
        import traceback

        return "" if self._error is None else "".join(traceback.format_exception(self._error))

    def close(self, grace_s: float) -> None:
        """Wait for the agents to leave; wake them if they do not."""
        if self._thread is not None:
            self._thread.join(grace_s)
            if self._thread.is_alive():
                self._endpoint.wake()
                self._thread.join(grace_s)
        self._endpoint.close()


def _allow_files(more: int) -> None:
    """Raise this process's limit of open files where ``more`` of them would not fit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 256 + more
    if soft != resource.RLIM_INFINITY and soft < wanted:
        limit = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
