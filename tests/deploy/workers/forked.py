"""Orders of worker processes in tests. Fork servers import this module: it imports nothing else of ours at first."""

from __future__ import annotations

import os
import signal
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple


class ReportModules(NamedTuple):
    """Write the names of all modules of a worker, which are those of the fork server, to a file."""

    config: Any
    path: str

    def __call__(self, worker: int) -> None:
        Path(self.path).write_text("\n".join(sys.modules))


def prepared(order: ReportModules) -> ReportModules:
    """Build the shards, as before the fork of a run's workers."""
    from deploy.workers.shared_shards import share_shards

    assert share_shards(order.config) is not order.config or not order.config.own_process
    return order


class KillParent(NamedTuple):
    """Write the worker's process id to a file, kill the fork server, and stay."""

    path: str

    def __call__(self, worker: int) -> None:
        Path(self.path).write_text(str(os.getpid()))
        os.kill(os.getppid(), signal.SIGKILL)
        time.sleep(60.0)


def exit_with_policy(worker: int) -> None:
    """End with the number of the worker's scheduling policy as its status."""
    os._exit(os.sched_getscheduler(0))
