"""Runs of a campaign in a Dask worker: each thread of the worker has a process of its own, which runs the scenes."""

from __future__ import annotations

import threading
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Final, final

from deploy.errors import DeployError, InputError
from deploy.scenes.fingerprint import differences, run_fingerprint
from deploy.studies.campaign.pool import ExecutorPool
from deploy.workers.pool import WorkerPool

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from deploy.scenes.scene import Scene
    from deploy.studies.campaign.result import CaseRecord

_IDLE_S: Final = 20.0
"""Wall time after which a process without a run ends."""

_stopped: set[str] = set()
"""Campaigns whose runs are to end."""

_checked: dict[str, list[str]] = {}
"""Differences of this worker from the process of a campaign, by campaign."""


@final
@dataclass(frozen=True, slots=True)
class RunOrder:
    """Order of a campaign's runs, the same for all of them.

    Attributes:
        campaign: Identifier of the campaign.
        scene: Scene whose facts are compared.
        facts: Facts of the process that manages the campaign.
        limit_s: Wall time of a run, after which it is ended.
        check: Whether runs check the invariants of their programs.
    """

    campaign: str
    scene: Scene
    facts: Mapping[str, str]
    limit_s: float
    check: bool


class OtherFactsError(DeployError):
    """A worker would produce other bits."""


class StoppedError(DeployError):
    """The campaign was interrupted."""


@final
class _RunProcess:
    """Process of one thread of a Dask worker, which ends when it has been idle for a while."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._pool: ExecutorPool | None = None
        self._order: RunOrder | None = None
        self._timer: threading.Timer | None = None

    def run(self, scene: Scene, order: RunOrder) -> CaseRecord:
        """Run a scene."""
        with self._lock:
            if self._timer is not None:
                self._timer.cancel()
            if self._order is not None and self._order.campaign != order.campaign:
                self._close()
            pool = self._pool
            if pool is None:
                pool = self._pool = ExecutorPool(
                    1, order.limit_s, partial(_poll, order.campaign), check=order.check
                )
                self._order = order
            try:
                ((_, record),) = pool.map([scene])
            except BaseException:
                self._close()
                raise
            self._timer = threading.Timer(_IDLE_S, self._expire)
            self._timer.daemon = True
            self._timer.start()
            return record

    def _expire(self) -> None:
        with self._lock:
            # a run that began meanwhile has cancelled this timer and will start another
            if self._timer is threading.current_thread():
                self._close()

    def _close(self) -> None:
        pool, self._pool, self._order, self._timer = self._pool, None, None, None
        if pool is not None:
            pool.__exit__(None, None, None)


_own = threading.local()


def run_scene(scene: Scene, order: RunOrder) -> CaseRecord:
    """Run a scene in the process of this thread; a run that fails, hangs or is killed is a record of its own.

    Raises:
        OtherFactsError: This worker would produce other bits.
        WorkerError: No process can be started.
        StoppedError: The campaign was interrupted.
    """
    if order.campaign not in _checked:
        _checked[order.campaign] = differences(order.facts, run_fingerprint(order.scene))
    if _checked[order.campaign]:
        raise OtherFactsError(f"differs from the campaign's start: {'; '.join(_checked[order.campaign])}")
    if not hasattr(_own, "process"):
        _own.process = _RunProcess()
    process: _RunProcess = _own.process
    return process.run(scene, order)


def _poll(campaign: str) -> None:
    if campaign in _stopped:
        raise StoppedError("the campaign was interrupted")


def stop_runs(campaign: str) -> None:
    """End the runs of a campaign in this worker."""
    _stopped.add(campaign)


def compile_kernels(scenes: Sequence[Scene]) -> None:
    """Compile the kernels of scenes in a process of its own, so that the worker stays responsive.

    Raises:
        WorkerError: The process failed.
    """
    with WorkerPool() as pool:
        pool.start(partial(_compile, tuple(scenes)), ["mdms warm"])
        while not pool.wait(60.0):
            pass
        if pool.failures or pool.ended != {0: 0}:
            pool.check()


def _compile(scenes: Sequence[Scene], worker: int) -> None:
    from deploy.runs.compile_ahead import compile_scene
    from deploy.util.formatting import silent

    del worker
    for scene in scenes:
        with suppress(InputError):  # every run of it will say so
            compile_scene(scene, silent)
