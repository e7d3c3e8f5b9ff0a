"""A Dask cluster of processes on loopback, as somebody would start it by hand."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

PATIENCE_S = 60.0


@dataclass
class Dask:
    """Scheduler and workers; a worker runs one task at a time and is not started again."""

    folder: Path
    options: tuple[str, ...] = ()
    """Options of all processes, such as credentials."""
    address: str = ""
    workers: list[subprocess.Popen[bytes]] = field(default_factory=list)
    started: list[subprocess.Popen[bytes]] = field(default_factory=list)

    @property
    def file(self) -> Path:
        """Scheduler file."""
        return self.folder / "scheduler.json"

    def begin(self) -> None:
        """Start the scheduler."""
        loopback = ("--port", "0", "--dashboard-address", "127.0.0.1:0")
        self._start("scheduler", *loopback, "--scheduler-file", str(self.file))
        deadline = time.monotonic() + PATIENCE_S
        while not self.address:
            assert time.monotonic() < deadline, "no scheduler came"
            assert self.started[0].poll() is None, "the scheduler ended"
            time.sleep(0.05)
            try:
                self.address = json.loads(self.file.read_text())["address"]
            except (OSError, ValueError):
                continue

    def add_worker(self, environment: Mapping[str, str] | None = None) -> subprocess.Popen[bytes]:
        """Start a worker."""
        more = ("--scheduler-file", str(self.file), "--nthreads", "1", "--no-nanny", "--no-dashboard")
        local = ("--local-directory", str(self.folder), "--memory-limit", "0")
        worker = self._start("worker", *more, *local, environment=environment)
        self.workers.append(worker)
        return worker

    def wait(self) -> None:
        """Wait until the scheduler knows all workers."""
        from deploy.workers.cluster import DaskCluster

        with DaskCluster(self.address, 1) as cluster:
            cluster.client.wait_for_workers(len(self.workers), PATIENCE_S)

    def _start(
        self, role: str, *arguments: str, environment: Mapping[str, str] | None = None
    ) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", role, "--host", "127.0.0.1", *self.options, *arguments]
        with (self.folder / f"{role}-{len(self.started)}.log").open("wb") as log:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                env={**os.environ, **(environment or {})},
            )
        self.started.append(process)
        return process

    def end(self) -> None:
        """End every process."""
        for process in reversed(self.started):
            process.kill()
            process.wait()


@contextmanager
def dask_cluster(folder: Path, workers: int, options: tuple[str, ...] = ()) -> Iterator[Dask]:
    """A cluster with so many workers."""
    cluster = Dask(folder, options)
    try:
        cluster.begin()
        for _ in range(workers):
            cluster.add_worker()
        cluster.wait()
        yield cluster
    finally:
        cluster.end()


@contextmanager
def credentials(folder: Path) -> Iterator[tuple[str, ...]]:
    """Make a certificate that all processes share; options of Dask's commands, and the environment of clients."""
    import dask.config

    certificate, key = folder / "cluster.pem", folder / "cluster-key.pem"
    made = (
        "-newkey",
        "ec",
        "-pkeyopt",
        "ec_paramgen_curve:P-256",
        "-nodes",
        "-days",
        "30",
        "-subj",
        "/CN=dask",
    )
    subprocess.run(
        ["openssl", "req", "-x509", *made, "-keyout", str(key), "-out", str(certificate)],
        check=True,
        capture_output=True,
    )
    settings = {"ca-file": certificate, "client.cert": certificate, "client.key": key}
    named = {f"distributed.comm.tls.{name}": str(path) for name, path in settings.items()}
    environment = {
        f"DASK_{name.upper().replace('.', '__').replace('-', '_')}": path for name, path in named.items()
    }
    os.environ.update(environment)
    try:
        with dask.config.set(named):
            yield (
                *("--protocol", "tls", "--tls-ca-file", str(certificate)),
                *("--tls-cert", str(certificate), "--tls-key", str(key)),
            )
    finally:
        for name in environment:
            os.environ.pop(name)
