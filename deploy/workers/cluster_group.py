"""Group of workers on a Dask cluster: each shard of a run has a Dask worker of its own."""

from __future__ import annotations

import os
import threading
import time
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, final

from deploy.errors import InputError
from deploy.util.formatting import say
from deploy.util.signals import Interruption
from deploy.workers.groups import PRELOAD
from deploy.workers.listening import socket_path
from deploy.workers.pool import WorkerError, WorkerPool, describe_exit
from deploy.workers.worker import modules_of

if TYPE_CHECKING:
    from bus.partition import Partition
    from deploy.scenes.scene import Scene
    from deploy.workers.cluster import DaskCluster
    from deploy.workers.external import ExternalWorkers
    from deploy.workers.plan import Plan
    from deploy.workers.worker import WorkerConfig

_POLL_S: Final = 0.1
_WATCH_S: Final = 1.0
"""Interval at which lost Dask workers are looked for while the run waits for its cells."""


@final
@dataclass(frozen=True, slots=True)
class ShardTask:
    """Process of one shard, for a Dask worker; a call runs it to its end.

    Attributes:
        scene: Scene of the run.
        partition: Cells of each shard.
        shard: Number of the shard.
        run: Name of the run.
        connect: Endpoint of the plant.
        keys: Folder of the run's keys; None: no keys.
        role: Name of the shard's role.
    """

    scene: Scene
    partition: Partition
    shard: int
    run: str
    connect: str
    keys: Path | None
    role: str

    def __call__(self, worker: int) -> None:
        """Join the run, and run the shard's cells to the run's end."""
        from deploy.security.keyring import cells_identity
        from deploy.workers.shard_process import ShardProcess

        del worker
        identity = None if self.keys is None else cells_identity(self.keys, self.role)
        process = ShardProcess(self.scene, self.partition, self.shard, self.run, self.connect, identity, say)
        process.work(Interruption())


@final
@dataclass(frozen=True, slots=True)
class ShardEnd:
    """End of a shard's process in a Dask worker.

    Attributes:
        error: Error message, one line; empty where the shard ended with the run.
        detail: The traceback, if there is one.
    """

    error: str = ""
    detail: str = ""


_stopped: set[str] = set()
"""Runs whose processes are to end in this Dask worker."""


def run_shard(task: ShardTask, name: str) -> ShardEnd:
    """Run a shard in a process of its own, which ends with this Dask worker."""
    with WorkerPool((*PRELOAD, "deploy.workers.shard_process", *modules_of(task.scene))) as pool:
        pool.start(task, [name])
        while pool.running and task.run not in _stopped:
            pool.poll(_POLL_S)
        if pool.failures:
            return ShardEnd(pool.failures[0].error, pool.failures[0].detail)
        status = pool.ended.get(0, 0)
        return ShardEnd(f"ended before the run did: {describe_exit(status)}" if status else "")


def stop_shards(run: str) -> None:
    """End the processes of a run in this Dask worker."""
    _stopped.add(run)


@final
class ClusterWorkers:
    """Group of processes on Dask workers, a shard each, which join the run by themselves.

    Dask has no gang scheduling: it would begin some tasks and queue others. Each task is therefore pinned to a worker
    of its own, the plant's barrier decides whether all came, and no task is repeated.

    Args:
        cluster: Connected cluster with a worker for each shard; closed with the group.
        plan: Plan of the run.
        keys: Folder of the run's keys, on every host of the cluster; None: no keys.
        external: Side of the group that answers the processes.
        connect: Endpoint of the plant.

    Raises:
        InputError: A Dask worker can't reach the plant's socket.
    """

    def __init__(
        self, cluster: DaskCluster, plan: Plan, keys: Path | None, external: ExternalWorkers, connect: str
    ) -> None:
        self._cluster = cluster
        self._plan = plan
        self._keys = None if keys is None else keys.absolute()
        self._external = external
        self._workers = cluster.least_busy(plan.workers)
        self._futures: list[Any] = []
        self._lock = threading.Lock()
        self._ends: dict[int, ShardEnd] = {}
        self._watched = time.monotonic()
        self._check_reach(connect)

    def start(self, order: WorkerConfig) -> None:
        """Start the process of each shard."""
        plan, client = self._plan, self._cluster.client
        self._external.start(order)
        for shard, worker in enumerate(self._workers):
            task = ShardTask(
                order.scene, plan.partition, shard, plan.run, order.connect, self._keys, plan.cut.role(shard)
            )
            future = client.submit(
                run_shard,
                task,
                plan.processes[shard + 1].name,
                key=f"mdms-{plan.run}-{shard}",
                workers=[worker],
                allow_other_workers=False,
                retries=0,
                pure=False,
            )
            future.add_done_callback(partial(self._note, shard))
            self._futures.append(future)

    def _check_reach(self, connect: str) -> None:
        path = socket_path(connect)
        if path is None:
            return
        found: dict[str, bool] = self._cluster.client.run(os.path.exists, path, workers=self._workers)
        elsewhere = [worker for worker, there in found.items() if not there]
        if elsewhere:
            raise InputError(
                f"--cluster: worker {elsewhere[0]} is on another host, and the plant listens on a socket of this one: "
                "--join tls/HOST:PORT with --keys DIR (mdms keys --host HOST)"
            )

    def _note(self, shard: int, future: Any) -> None:
        """Note how a task ended; called in a thread of Dask."""
        if future.status == "finished":
            end: ShardEnd = future.result()
        elif future.status == "error":
            end = ShardEnd(str(future.exception()))
        else:
            end = ShardEnd("its Dask worker, or the scheduler, was lost")
        with self._lock:
            self._ends.setdefault(shard, end)

    def restart(self, order: WorkerConfig, shard: int) -> None:  # noqa: ARG002
        """Raise AssertionError: no shard is started again."""
        raise AssertionError("this is a bug: shards of a cluster are not started again")

    def ended(self, shard: int) -> bool:
        """Whether the process of a shard has ended."""
        with self._lock:
            return shard in self._ends

    def trouble(self, timeout_s: float) -> bool:
        """Whether a process has failed or its Dask worker is lost, after a wait of ``timeout_s``."""
        self._external.trouble(timeout_s)
        if time.monotonic() - self._watched > _WATCH_S:
            self._watched = time.monotonic()
            there = self._cluster.threads()
            with self._lock:
                for shard, worker in enumerate(self._workers):
                    if worker not in there:
                        self._ends.setdefault(shard, ShardEnd("its Dask worker was lost"))
        with self._lock:
            return bool(self._ends)

    def programs_failed(self) -> bool:
        """Return False: the first failure that is known is reported."""
        return False

    def check(self) -> None:
        """Raise WorkerError if a process has failed or its Dask worker is lost."""
        with self._lock:
            for shard, end in sorted(self._ends.items()):
                raise WorkerError(f"{self._name(shard)}: {end.error or 'ended before the run did'}")

    def details(self) -> str:
        """Return the tracebacks of the processes that raised."""
        with self._lock:
            failed = [(shard, end.detail) for shard, end in sorted(self._ends.items()) if end.detail]
        return "\n".join(f"{self._name(shard)}: {detail}" for shard, detail in failed)

    def _name(self, shard: int) -> str:
        return f"{self._plan.processes[shard + 1].name} on {self._workers[shard]}"

    def close(self, grace_s: float) -> None:
        """End every process, and disconnect; stopping processes get ``grace_s`` to leave."""
        self._external.close(grace_s)
        deadline = time.monotonic() + grace_s
        while not self._all_ended() and time.monotonic() < deadline:
            time.sleep(_POLL_S / 10)
        if not self._all_ended():
            with suppress(Exception):  # whoever can't be reached runs no cells of this run any more
                self._cluster.client.run(stop_shards, self._plan.run, on_error="ignore")
        self._cluster.close()

    def _all_ended(self) -> bool:
        return all(map(self.ended, range(len(self._futures))))
