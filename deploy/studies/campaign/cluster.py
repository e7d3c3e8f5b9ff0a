"""Runs of a campaign on a Dask cluster."""

from __future__ import annotations

import secrets
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from functools import partial
from importlib import import_module
from itertools import count, islice
from typing import TYPE_CHECKING, Any, Final, final

from deploy.errors import DeployError
from deploy.scenes.fingerprint import run_fingerprint
from deploy.studies.campaign.cluster_worker import RunOrder, compile_kernels, run_scene, stop_runs
from deploy.studies.campaign.result import CaseRecord

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from deploy.workers.cluster import DaskCluster

_POLL_S: Final = 0.05
"""Interval at which signals are checked."""
_WATCH_S: Final = 2.0
"""Interval at which the workers are counted."""
_LEAST: Final = 2
"""Runs a thread, in progress and queued, at which more are handed out: no worker is to wait for the next one."""
_MOST: Final = 6
"""Runs a thread after that."""
_RETRIES: Final = 2
"""Repetitions of a run that could not be started in its worker."""


class ClusterError(DeployError):
    """Failure of the cluster; completed runs are kept."""


@final
class ClusterExecutor:
    """Executor of scenes on a Dask cluster.

    Dask repeats the runs in flight of a worker that is lost. A completed run is fetched at once, and not repeated.

    Args:
        cluster: Connected cluster.
        scene: Scene of the campaign, whose facts all workers must share.
        limit_s: Wall time of a run, after which it is ended.
        poll: Called many times a second; may raise.
        check: Whether runs check the invariants of their programs.
        say: Called with a line for people.

    Raises:
        InputError: A worker would produce other bits.
    """

    def __init__(
        self,
        cluster: DaskCluster,
        scene: Scene,
        limit_s: float,
        poll: Callable[[], None],
        *,
        check: bool,
        say: Callable[[str], None],
    ) -> None:
        self._cluster = cluster
        self._poll = poll
        self._say = say
        self._threads = 0
        self._counted = -_WATCH_S
        self._waits = False
        self._numbers = count()
        """Of all runs: Dask would answer a key that it knows with the result of the other run."""
        facts = cluster.check_alike(partial(run_fingerprint, scene))
        self._order = RunOrder(secrets.token_hex(8), scene, facts, limit_s, check)

    def warm(self, scenes: Sequence[Scene]) -> None:
        """Compile the kernels of scenes once on each host, before several workers look for them there."""
        client = self._cluster.client
        futures = [
            client.submit(compile_kernels, scenes, workers=[worker], allow_other_workers=True, pure=False)
            for worker in self._cluster.hosts().values()
        ]
        while not all(future.done() for future in futures):
            self._poll()
            time.sleep(_POLL_S)
        # whatever failed there fails each run, which says so

    def map(self, scenes: Iterable[Scene]) -> Iterator[tuple[int, CaseRecord]]:
        """Run scenes; see ``Executor``.

        Raises:
            ClusterError: The scheduler is lost, or a worker can't run anything.
        """
        completed = import_module("distributed").as_completed(
            loop=self._cluster.client.loop, with_results=True, raise_errors=False
        )
        more = enumerate(scenes)
        running: dict[str, tuple[int, Any]] = {}
        exhausted = False
        try:
            while running or not exhausted:
                self._count()
                if not exhausted and len(running) <= _LEAST * self._threads:
                    wanted = _MOST * self._threads - len(running)
                    taken = list(islice(more, wanted))
                    exhausted = len(taken) < wanted
                    futures = self._submit([scene for _, scene in taken])
                    running |= {
                        future.key: (place, future) for (place, _), future in zip(taken, futures, strict=True)
                    }
                    completed.update(futures)
                batch = completed.next_batch(block=False)
                if not batch:
                    with completed.thread_condition:
                        completed.thread_condition.wait(_POLL_S)
                for future, result in batch:
                    place, _ = running.pop(future.key)
                    yield place, record_of(future, result, self._cluster.address)
                self._poll()
        finally:
            if running:
                self._cancel([future for _, future in running.values()])

    def _submit(self, scenes: Sequence[Scene]) -> list[Any]:
        """Submit runs together, which costs the scheduler less than one by one."""
        keys = [f"mdms-{self._order.campaign}-{next(self._numbers)}" for _ in scenes]
        try:
            return self._cluster.client.map(run_scene, scenes, order=self._order, key=keys, retries=_RETRIES)
        except RuntimeError:  # the client has closed
            raise _lost(self._cluster.address) from None

    def _count(self) -> None:
        """Count the threads of all workers; say so when there are none."""
        if time.monotonic() - self._counted < _WATCH_S:
            return
        self._counted = time.monotonic()
        try:
            threads = sum(self._cluster.threads().values())
        except (OSError, RuntimeError, TimeoutError):
            raise _lost(self._cluster.address) from None
        if not threads and not self._waits:
            self._say(f"{self._cluster.address} has no worker: waiting for one")
        self._threads, self._waits = threads, not threads

    def _cancel(self, futures: Sequence[Any]) -> None:
        """End the runs in flight."""
        client = self._cluster.client
        with suppress(Exception):  # whoever can't be reached runs nothing that anybody waits for
            client.cancel(list(futures))
            client.run(stop_runs, self._order.campaign, on_error="ignore")


def record_of(future: Any, result: Any, scheduler: str) -> CaseRecord:
    """Return the record of a run that Dask has completed or given up.

    Args:
        future: Dask's future of the run.
        result: Its result, if it has one.
        scheduler: Address of the scheduler.

    Raises:
        ClusterError: The scheduler is lost, or a worker can't run anything.
    """
    if future.status == "finished":
        assert isinstance(result, CaseRecord)
        return result
    if future.status != "error":
        raise _lost(scheduler)
    error = future.exception()
    if type(error).__name__ == "KilledWorker":
        return CaseRecord(status="failed", reason=f"its worker was lost {error.allowed_failures + 1} times")
    raise ClusterError(f"a worker of {scheduler}: {error}")


def _lost(scheduler: str) -> ClusterError:
    return ClusterError(f"lost the scheduler {scheduler}; completed runs are kept")
