"""Connection to a Dask cluster: one that runs already, or one of this machine for the time of a command."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self, final

from deploy.errors import InputError
from deploy.scenes.fingerprint import differences
from deploy.util.formatting import plural
from deploy.workers.listening import is_local

LOCAL: Final = "local"
"""Address of a cluster that is started on this machine and ends with the command."""

_ADDRESS: Final = re.compile(
    r"(?:(?P<protocol>[a-z]+)://)?(?P<place>(?:\[[0-9A-Fa-f:.%]+\]|[^\s:/\[\]]+):\d+)"
)
_ENCRYPTED: Final = ("tls", "wss")
_CONNECT_S: Final = 10.0
"""Longest wait for the scheduler's answer."""
_OPTION: Final = "--cluster"
_THRIFTY: Final = {"distributed.worker.profile.enabled": False, "distributed.admin.tick.interval": "1s"}
"""Settings of a cluster of this machine, whose scheduler and workers share the processors with the runs."""
_DEAF: Final = "import signal; signal.signal(signal.SIGINT, signal.SIG_IGN)"
"""Run by each worker of this machine: Ctrl-C in the terminal is for the main process alone."""


@final
class DaskCluster:
    """Connected Dask cluster; leaving the context disconnects, and ends a cluster of this machine.

    Args:
        address: ``local``; ``PROTOCOL://HOST:PORT`` of a scheduler; or the scheduler's file.
        workers: Number of workers of ``local``, each with one run or shard at a time.
        insecure: Accept a scheduler on another host without TLS.

    Attributes:
        client: Dask's ``Client``.
        address: Address of the scheduler.

    Raises:
        InputError: Dask is not installed, the address is invalid or not allowed, or no scheduler answers.
    """

    def __init__(self, address: str, workers: int, *, insecure: bool = False) -> None:
        found = None if address == LOCAL else scheduler_address(address, insecure=insecure)
        distributed = _library()
        with ExitStack() as stack:
            if found is None:
                self.client = _own(distributed, stack, workers)
            else:
                self.client = _connected(distributed, stack, found)
            self.address = str(self.client.scheduler.address)
            self._stack = stack.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Disconnect, and end a cluster of this machine; a second call does nothing."""
        self._stack.close()

    @property
    def dashboard(self) -> str:
        """Address of the scheduler's dashboard; empty without one."""
        return str(self.client.dashboard_link or "")

    def threads(self) -> dict[str, int]:
        """Return the number of tasks that each worker runs at a time, by its address."""
        return dict(self.client.nthreads())

    def least_busy(self, number: int) -> list[str]:
        """Return the addresses of so many workers, those with the fewest tasks."""
        tasks: dict[str, Any] = self.client.processing()
        return sorted(self.threads(), key=lambda worker: (len(tasks.get(worker, ())), worker))[:number]

    def hosts(self) -> dict[str, str]:
        """Return one worker of each host, by the host."""
        workers = self.client.scheduler_info(n_workers=-1)["workers"]
        return {str(about["host"]): str(address) for address, about in workers.items()}

    def check_alike(self, facts: Callable[[], dict[str, str]]) -> dict[str, str]:
        """Check that all workers have what decides a run's bits.

        Args:
            facts: Importable function; called here and in every worker.

        Returns:
            The facts of this process.

        Raises:
            InputError: Names each worker that differs, and in what.
        """
        here = facts()
        there: dict[str, Any] = self.client.run(facts, on_error="return")
        lines = [
            line for address, found in sorted(there.items()) if (line := _difference(address, found, here))
        ]
        if lines:
            raise InputError("\n".join(lines))
        return here


def connect_for(address: str, shards: int, *, insecure: bool) -> DaskCluster:
    """Connect to a cluster that has a worker for each shard.

    Raises:
        InputError: There is no such cluster, or it has fewer workers.
    """
    cluster = DaskCluster(address, shards, insecure=insecure)
    there = len(cluster.threads())
    if there >= shards:
        return cluster
    cluster.close()
    raise InputError(
        f"{_OPTION} {address}: has {plural(there, 'worker')} for {plural(shards, 'shard')}, and each shard needs a "
        f"worker of its own: start more, or --processes {max(there, 1)}"
    )


def scheduler_address(text: str, *, insecure: bool) -> str:
    """Return the address of a scheduler, from itself or from the scheduler's file.

    Raises:
        InputError: The address is invalid, or leaves this host without TLS.
    """
    address = text
    if (path := Path(text)).is_file():
        try:
            address = str(json.loads(path.read_bytes())["address"])
        except (OSError, ValueError, LookupError, TypeError) as error:
            raise InputError(f"{_OPTION} {text}: is no scheduler file: {error}") from None
    match = _ADDRESS.fullmatch(address)
    if match is None:
        if text.endswith(".json"):
            raise InputError(
                f"{_OPTION} {text}: there is no such file; dask scheduler --scheduler-file writes one"
            )
        raise InputError(
            f"{_OPTION} {text}: must be {LOCAL}, PROTOCOL://HOST:PORT of a Dask scheduler, or its scheduler file"
        )
    protocol = match["protocol"] or "tcp"
    if protocol not in _ENCRYPTED and not insecure and not is_local(f"{protocol}/{match['place']}"):
        raise InputError(
            f"{_OPTION} {text}: leaves this host, and whoever reads or changes the traffic could run programs: use a "
            "scheduler with tls:// (docs/clusters.md), or --insecure"
        )
    return f"{protocol}://{match['place']}"


def _difference(address: str, found: Any, here: Mapping[str, str]) -> str:
    if isinstance(found, BaseException):
        return f"{_OPTION}: worker {address}: {type(found).__name__}: {found}"
    other = "; ".join(differences(here, found))
    return f"{_OPTION}: worker {address} differs, and so would its digests: {other}" if other else ""


def _library() -> Any:
    """Import Dask's scheduler.

    Raises:
        InputError: It is not installed; the message names the extra.
    """
    try:
        return import_module("distributed")
    except ImportError:
        raise InputError(
            f"{_OPTION} needs Dask, which comes with the extra cluster: pip install 'mdms-emulator[cluster]'"
        ) from None


def _own(distributed: Any, stack: ExitStack, workers: int) -> Any:
    """Start a cluster on loopback that this process alone can use."""
    import logging

    try:
        security = distributed.Security.temporary()
    except ImportError:
        raise InputError(
            f"{_OPTION} {LOCAL} needs the library cryptography, which comes with the extra cluster: "
            "pip install 'mdms-emulator[cluster]'"
        ) from None
    stack.enter_context(import_module("dask.config").set(_THRIFTY))  # inherited by the workers
    cluster = distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        host="127.0.0.1",
        protocol="tls",
        security=security,
        dashboard_address="127.0.0.1:0",
        memory_limit=0,
        preload=[_DEAF],
        silence_logs=logging.CRITICAL,
    )
    stack.callback(cluster.close)
    return stack.enter_context(distributed.Client(cluster, set_as_default=False))


def _connected(distributed: Any, stack: ExitStack, address: str) -> Any:
    try:
        client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False)
    except (OSError, TimeoutError) as error:
        raise InputError(f"{_OPTION} {address}: no scheduler answers: {error}") from None
    except (TypeError, ValueError) as error:  # Dask's word for credentials that are missing
        raise InputError(f"{_OPTION} {address}: {error}: set Dask's credentials (docs/clusters.md)") from None
    return stack.enter_context(client)


def describe(cluster: DaskCluster) -> str:
    """Return a line about a cluster for people."""
    workers = plural(len(cluster.threads()), "worker")
    link = f", dashboard {cluster.dashboard}" if cluster.dashboard else ""
    return f"Dask scheduler {cluster.address}, {workers}{link}"
