"""Plan of a run's processes and endpoints, which can be printed before anything is started."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, final

from bus.errors import PartitionError
from bus.lattice import Lattice
from bus.partition import Partition
from bus.wire.keys import WireFormat
from deploy.errors import InputError
from deploy.scenes.memory_limit import too_many_workers
from deploy.security.roles import ProcessLayout
from deploy.workers.listening import Kind, Option, check_listening, free_port, joined_at

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from deploy.security.manifest import KeyManifest


Transport = Literal["zenoh", "memory"]
Processes = int | Literal["each"]
_Endpoints = tuple[str | None, str | None]
"""Endpoint for listeners and operators, and endpoint for processes of cells."""

ONE_WORKER_CELLS = 1_000
"""Number of cells up to which a second worker costs more in messages than it saves in work."""


@final
@dataclass(frozen=True, slots=True)
class RunOptions:
    """Options of a run, which must not change the simulated result of a scene.

    Attributes:
        processes: Worker processes for the cells; ``each``: one a cell; 0: everything in this process; None:
            by the number of cells and processor cores.
        transport: Transport of the messages; ``memory`` needs ``processes`` 0.
        wire: Wire format; None: that of the keys, or ``packed``. Where each cell has its own process, ``relayed``,
            or ``per_cell`` if ``listen`` or ``join`` names an endpoint for others.
        listen: Endpoint for listeners and operators; None: a free loopback port.
        join: Endpoint for processes of cells; None: a socket in a folder of this user's alone, or with keys a free
            loopback port.
        realtime: Simulated seconds per wall second; None: as fast as possible.
        paused: Whether the run begins paused, until ``mdms control`` or a viewer lets it go on.
        output: Folder for everything the run leaves behind; None: a new one under ``runs/``.
        picture: Whether to draw the overview.
        registers: Period at which the cells' registers are recorded, ticks; None: never.
        messages: Period at which the messages between cells are recorded, ticks; None: never.
        trace_messages: Cells whose messages are traced, as ``deploy.util.cell_ranges`` has them; None: none.
        check: Whether the invariants of the program are checked: ``stop`` ends the run at the first violation,
            ``count`` goes on and counts; None: they aren't.
        respawn: Most restarts of lost workers in all.
        replay: Folder of a recorded run of the scene, whose live commands and losses are repeated; None: no replay.
        protocol_report: Period at which the protocol's field is sampled for the report, ticks; None: no report.
        keys: Folder made by ``mdms keys``, with credentials and rights of each role; None: no credentials.
        insecure: Accept endpoints that any peer can reach.
        checkpoint_s: Period of checkpoints, s of wall time; None: no checkpoints.
        external: Whether the processes of cells are started by others, and join at ``join`` or at ``router``.
        router: Endpoint of a router that the plant connects to, instead of listening; None: the plant listens.
        name: Name of the run on the bus; None: a new one.
        cluster: Dask cluster whose workers run the processes of cells, with ``external``; None: no cluster.
    """

    processes: Processes | None = None
    transport: Transport = "zenoh"
    wire: WireFormat | None = None
    listen: str | None = None
    join: str | None = None
    realtime: float | None = None
    paused: bool = False
    output: Path | None = None
    picture: bool = True
    registers: int | None = None
    messages: int | None = None
    trace_messages: str | None = None
    protocol_report: int | None = None
    check: Literal["stop", "count"] | None = None
    respawn: int = 0
    replay: Path | None = None
    keys: Path | None = None
    insecure: bool = False
    checkpoint_s: float | None = None
    external: bool = False
    router: str | None = None
    name: str | None = None
    cluster: str | None = None


@final
@dataclass(frozen=True, slots=True)
class PlannedProcess:
    """A process to start, or a part of this process.

    Attributes:
        name: Name in process lists and messages.
        role: ``plant`` or ``cells``.
        where: ``this process``, ``a thread of this process``, ``a separate process``, ``started by others`` or
            ``a Dask worker``.
        cells: ``(row, column)`` of the cells that run in it.
        listen: Endpoint on which it listens for listeners and operators, or None.
        join: Endpoint on which it listens for processes of cells, or None.
        connect: Endpoint it connects to, or None.
        ready: Condition for the first tick, in words.
    """

    name: str
    role: Literal["plant", "cells"]
    where: str
    cells: tuple[tuple[int, int], ...]
    listen: str | None
    join: str | None
    connect: str | None
    ready: str


@final
@dataclass(frozen=True, slots=True)
class Plan:
    """Everything that a run will start.

    Attributes:
        run: Name of the run on the bus.
        scene: Name of the scene.
        setting: Value of ``--processes``, after defaults.
        workers: Number of worker processes.
        transport: Transport of the messages.
        wire: Wire format.
        partition: Cells of each shard, one shard a worker (one shard if there are no workers).
        processes: Process of the plant, then the processes of cells.
        external: Whether the processes of cells are started by others.
    """

    run: str
    scene: str
    setting: Processes
    workers: int
    transport: Transport
    wire: WireFormat
    partition: Partition
    processes: tuple[PlannedProcess, ...]
    external: bool = False

    @property
    def cut(self) -> ProcessLayout:
        """Layout of the cells in processes."""
        return ProcessLayout(self.partition, self.wire, tuple(process.name for process in self.processes[1:]))

    def as_json(self) -> dict[str, Any]:
        """Return the plan in JSON's types; cells are ``row,column``."""
        return {
            "run": self.run,
            "scene": self.scene,
            "processes": self.setting,
            "transport": self.transport,
            "wire": self.wire,
            "start": [
                {
                    "name": process.name,
                    "role": process.role,
                    "where": process.where,
                    "cells": [f"{row},{column}" for row, column in process.cells],
                    "listen": process.listen,
                    "join": process.join,
                    "connect": process.connect,
                    "ready": process.ready,
                }
                for process in self.processes
            ],
        }


def plan(scene: Scene, options: RunOptions, run: str) -> Plan:
    """Plan the processes and endpoints of a run of ``scene``.

    Raises:
        InputError: The options do not go together, or not with the array.
    """
    lattice = scene.lattice()
    setting = _processes(options, lattice)
    workers = len(lattice) if setting == "each" else setting
    option = "--shards" if options.external and options.cluster is None else "--processes"
    if not options.external and (rule := too_many_workers(workers, len(lattice))):
        raise InputError(f"{option} {setting}: {rule}")
    about = _about_keys(options)
    kind = None if about is None else about.kind
    for name, endpoint in _asked(options):
        check_listening(endpoint, kind, insecure=options.insecure, option=name)
    _check(options, scene, workers)
    try:
        partition = Partition.even(lattice, workers if options.external else max(1, workers))
    except PartitionError:
        least = 1 if options.external else 0
        raise InputError(
            f"{option} {workers}: must be each or {least}..{len(lattice)}, the number of cells"
        ) from None
    return Plan(
        run=run,
        scene=scene.name,
        setting=setting,
        workers=workers,
        transport=options.transport,
        wire=options.wire or _wire(options, setting, workers, about),
        partition=partition,
        processes=tuple(
            _processes_of(
                partition, _where(options, workers), setting, _endpoints(options, kind), scene.stall.start_s
            )
        ),
        external=options.external,
    )


def _asked(options: RunOptions) -> list[tuple[Option, str]]:
    """Return the endpoints to listen on that the options name, with the option that names each."""
    join: Option = "--listen" if options.external and options.cluster is None else "--join"
    asked: list[tuple[Option, str | None]] = [("--listen", options.listen), (join, options.join)]
    return [(option, endpoint) for option, endpoint in asked if endpoint is not None]


def _where(options: RunOptions, workers: int) -> str:
    """Say where processes of cells run."""
    if options.cluster is not None:
        return "a Dask worker"
    if options.external:
        return "started by others"
    return "a separate process" if workers else "a thread of this process"


def _check(options: RunOptions, scene: Scene, workers: int) -> None:
    """Refuse options that are out of range, or incompatible with the scene or the workers."""
    for name, ticks in (
        ("registers", options.registers),
        ("messages", options.messages),
        ("protocol-report", options.protocol_report),
    ):
        if ticks is not None and ticks < 1:
            raise InputError(f"--{name} {ticks}: must be a number of ticks from 1")
    if options.respawn < 0:
        raise InputError(f"--respawn {options.respawn}: must be at least 0")
    if options.respawn and not workers:
        raise InputError(
            "--respawn: there are no worker processes to restart: it needs --processes N or each"
        )
    if options.cluster is not None:
        _check_cluster(options, workers)
    if options.respawn and scene.effects.clock is not None:
        raise InputError("--respawn: doesn't go with effects.clock: a restarted cell has lost its instants")
    if options.realtime is not None and not 0 < options.realtime < float("inf"):
        raise InputError(f"--realtime {options.realtime:g}: must be greater than 0")
    if options.paused and options.transport == "memory":
        raise InputError("--paused: the memory transport has no endpoint from which a run is resumed")
    if options.checkpoint_s is not None and not 0 < options.checkpoint_s < float("inf"):
        raise InputError(f"--checkpoint {options.checkpoint_s:g}: must be greater than 0")
    if options.checkpoint_s is not None and options.replay is not None:
        raise InputError("--checkpoint: a replayed run can't be saved; leave --checkpoint or --replay out")


def _check_cluster(options: RunOptions, workers: int) -> None:
    """Refuse options that don't go with a Dask cluster."""
    if options.processes is None or not workers:
        raise InputError(
            f"--cluster {options.cluster}: needs --processes N, the number of shards: each has a Dask worker of its own"
        )
    if options.respawn:
        raise InputError(
            "--respawn: doesn't go with --cluster: shards are not started again there; --checkpoint lets the run resume"
        )


def _about_keys(options: RunOptions) -> KeyManifest | None:
    """Return the manifest of the keys; None without keys."""
    if options.transport == "memory":
        for name, value in (("listen", options.listen), ("join", options.join), ("keys", options.keys)):
            if value is not None:
                raise InputError(
                    f"--{name}: the memory transport has no endpoint; leave --{name} or --transport memory out"
                )
    if options.keys is None:
        return None
    from deploy.security.keyring import Keyring

    return Keyring(options.keys).about


def _wire(options: RunOptions, setting: Processes, workers: int, about: KeyManifest | None) -> WireFormat:
    """Return the wire format of a run whose options name none."""
    if about is not None:
        return about.wire
    # Whoever is given an address may be any tool, or hardware: these read maps of single cells.
    by_others = options.external and options.cluster is None
    private = options.listen is None and options.join is None and not by_others
    if setting == "each":
        return "relayed" if private else "per_cell"
    return "relayed" if private and workers > 1 and options.cluster is None else "packed"


def _endpoints(options: RunOptions, kind: Kind | None) -> _Endpoints:
    if options.transport == "memory":
        return None, None
    if options.router is not None:
        return None, options.router
    return options.listen or free_port(kind), options.join or joined_at(kind)


def _processes(options: RunOptions, lattice: Lattice) -> Processes:
    if options.transport == "memory":
        if options.processes not in (None, 0):
            raise InputError(
                f"--transport memory --processes {options.processes}: "
                "memory is not shared between processes; it needs --processes 0"
            )
        return 0
    if options.processes is not None:
        return options.processes
    return 1 if len(lattice) <= ONE_WORKER_CELLS else min(2, os.cpu_count() or 1)


def _processes_of(
    partition: Partition, where: str, setting: Processes, endpoints: _Endpoints, start_s: float
) -> list[PlannedProcess]:
    listen, join = endpoints
    cells = partition.lattice.cells
    plant = PlannedProcess(
        name="plant",
        role="plant",
        where="this process",
        cells=(),
        listen=listen,
        join=join,
        connect=None,
        ready=f"all {len(cells)} cells alive and ready within {start_s:g} s",
    )
    processes = [plant]
    for shard in range(partition.count):
        own = tuple(cells[int(i)] for i in partition.cells(shard))
        processes.append(
            PlannedProcess(
                name=f"cell {own[0][0]},{own[0][1]}" if setting == "each" else f"cells {shard}",
                role="cells",
                where=where,
                cells=own,
                listen=None,
                join=None,
                connect=join,
                ready="firmware loaded, the plant and every neighbour's process reached",
            )
        )
    return processes
