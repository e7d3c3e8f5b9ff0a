"""Groups of workers that run the cells: worker processes, or a thread of the plant's process."""

from __future__ import annotations

import resource
import threading
from collections.abc import Sequence
from typing import Protocol, final

from bus.transports.base import Endpoint
from deploy.workers.forkserver import one_line
from deploy.workers.plan import Plan
from deploy.workers.pool import WorkerError, WorkerPool
from deploy.workers.shared_shards import share_shards
from deploy.workers.worker import WorkerConfig, serve

PRELOAD = (
    "asyncio",
    "msgpack",
    "numpy",
    "zenoh",
    "bus.lockstep",
    "bus.transports.event_loop",
    "bus.transports.zenoh",
    "cell_firmware.agent",
    "cell_firmware.build",
    "cell_firmware.loader",
    "deploy.scenes.scene",
    "deploy.workers.overrun",
    "deploy.workers.worker",
    "plant.array",
)
"""Modules that every worker needs, imported once before the workers are forked."""

_FILES_A_WORKER = 4
"""Upper estimate of open files in the plant's process for a worker's session."""


class WorkerGroup(Protocol):
    """Group of workers that run the cells: start, failures and end."""

    def start(self, order: WorkerConfig) -> None:
        """Start every agent, without waiting until the agents are ready."""
        ...

    def restart(self, order: WorkerConfig, shard: int) -> None:
        """Restart the agents of one shard; old agents are ended first."""
        ...

    def ended(self, shard: int) -> bool:
        """Whether the process of a shard has ended."""
        ...

    def trouble(self, timeout_s: float) -> bool:
        """Whether a worker has failed or ended, after a wait of up to ``timeout_s`` for a failure."""
        ...

    def programs_failed(self) -> bool:
        """Whether all failures so far are failed programs, and further programs may fail."""
        ...

    def check(self) -> None:
        """Raise WorkerError if a worker has failed or ended."""
        ...

    def details(self) -> str:
        """Return the tracebacks of failures, or an empty string."""
        ...

    def close(self, grace_s: float) -> None:
        """End every agent; stopping agents get ``grace_s`` to leave."""
        ...


@final
class WorkerProcesses:
    """Group of worker processes, one for each shard.

    Create the group early: the fork server imports its modules meanwhile.

    Args:
        plan: Plan of the run.
        modules: Further modules that the cells use.
    """

    def __init__(self, plan: Plan, modules: Sequence[str] = ()) -> None:
        self._names = [process.name for process in plan.processes if process.role == "cells"]
        self._crew = WorkerPool((*PRELOAD, *modules))

    def start(self, order: WorkerConfig) -> None:
        """Fork the workers."""
        _allow_files(_FILES_A_WORKER * len(self._names))
        self._crew.start(order, self._names, share_shards)

    def restart(self, order: WorkerConfig, shard: int) -> None:
        """Kill one worker and fork its replacement."""
        self._crew.restart(order, shard)

    def ended(self, shard: int) -> bool:
        """Whether the process of a shard has ended."""
        while self._crew.poll():
            pass
        return shard in self._crew.ended

    def trouble(self, timeout_s: float) -> bool:
        """Whether a worker has failed or ended."""
        self._crew.poll(timeout_s)
        return bool(self._crew.failures or self._crew.ended or self._crew.pipe_closed)

    def programs_failed(self) -> bool:
        """Whether all failures so far are failed programs."""
        while self._crew.poll():
            pass
        return self._crew.programs_failed

    def check(self) -> None:
        """Raise WorkerError if a worker has failed or ended."""
        self._crew.check()

    def details(self) -> str:
        """Return the tracebacks of the workers that raised."""
        crew = self._crew
        return "\n".join(f"{crew.name(failure.worker)}: {failure.detail}" for failure in crew.messages())

    def close(self, grace_s: float) -> None:
        """End every worker and the fork server."""
        self._crew.close(grace_s)


@final
class WorkerThread:
    """Group of agents in the event loop of one thread of this process.

    Args:
        endpoint: Endpoint of the cells, closed when the agents have ended.
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
        """Raise AssertionError: a thread can't be killed, and is never restarted."""
        raise AssertionError("this is a bug: there is no process to restart")

    def ended(self, shard: int) -> bool:  # noqa: ARG002
        """Whether the agents have ended."""
        return self._over.is_set()

    def trouble(self, timeout_s: float) -> bool:
        """Whether the agents have ended, after a wait of up to ``timeout_s``; agents end early only on failure."""
        return self._over.wait(timeout_s)

    def programs_failed(self) -> bool:
        """Return False: all programs start in one call, so that no further program can fail."""
        return False

    def check(self) -> None:
        """Raise WorkerError if an agent has raised."""
        if self._error is not None:
            raise WorkerError(f"cells: {one_line(self._error)}") from self._error
        if self._over.is_set():
            raise WorkerError("cells: the agents ended before the run did")

    def details(self) -> str:
        """Return the traceback of an agent that raised, or an empty string."""
        import traceback

        return "" if self._error is None else "".join(traceback.format_exception(self._error))

    def close(self, grace_s: float) -> None:
        """Wait ``grace_s`` for the agents to leave, then wake the agents' endpoint and wait again."""
        if self._thread is not None:
            self._thread.join(grace_s)
            if self._thread.is_alive():
                self._endpoint.wake()
                self._thread.join(grace_s)
        self._endpoint.close()


def _allow_files(more: int) -> None:
    """Raise this process's limit of open files if ``more`` files would not fit."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = 256 + more
    if soft != resource.RLIM_INFINITY and soft < wanted:
        limit = wanted if hard == resource.RLIM_INFINITY else min(wanted, hard)
        resource.setrlimit(resource.RLIMIT_NOFILE, (limit, hard))
