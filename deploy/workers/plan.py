"""Plan of a run's processes and endpoints, which can be printed before anything is started."""

from __future__ import annotations

import ipaddress
import os
import re
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal, final

from bus.errors import PartitionError
from bus.lattice import Lattice
from bus.partition import Partition
from bus.wire.keys import WireFormat
from deploy.errors import InputError
from deploy.scenes.memory_limit import too_many_workers
from deploy.security.roles import ProcessLayout

if TYPE_CHECKING:
    from deploy.scenes.scene import Scene
    from deploy.security.manifest import KeyManifest


Kind = Literal["certificate", "password"]
Option = Literal["--listen", "--join"]
"""``--listen``: for listeners and operators. ``--join``: for processes of cells."""

_ENDPOINT: Final = re.compile(r"(?P<protocol>[a-z_-]+)/(?P<address>\S.*)")
_HOST_AND_PORT: Final = re.compile(
    r"(?P<host>\[[0-9A-Za-z:.%]+\]|[^\s\[\]:,\"'/\\?#]+):\d+(?P<more>[?#][^\s,\"'\\]*)?"
)
_INTERFACE: Final = re.compile(r"[#;&](?:iface|bind)=(?P<interface>[^;&#]*)")
_SOCKET: Final = "unixsock-stream"
_LOCAL: Final = (_SOCKET, "unixpipe")
"""Protocols that don't leave the host."""


def free_port(kind: Kind | None) -> str:
    """Describe an endpoint on loopback whose port is chosen at the start of the run."""
    return f"{'tls' if kind == 'certificate' else 'tcp'}/127.0.0.1 (a free port)"


def joined_at(kind: Kind | None) -> str:
    """Describe the default endpoint that cells join."""
    return f"{_SOCKET} (a private folder)" if kind is None else free_port(kind)


def socket_in(folder: str) -> str:
    """Return the endpoint of a Unix socket in a folder."""
    return f"{_SOCKET}/{folder}/run"


def check_listening(endpoint: str, kind: Kind | None, *, insecure: bool, option: Option = "--listen") -> None:
    """Check that the plant may listen on an endpoint.

    Args:
        endpoint: ``PROTOCOL/ADDRESS``.
        kind: Kind of credentials; None: no credentials.
        insecure: Accept an endpoint that any peer can reach.
        option: Option that names the endpoint.

    Raises:
        InputError: The endpoint is invalid, is not TLS although certificates are used, or lets strangers connect or,
            with passwords, read the traffic.
    """
    match = _ENDPOINT.fullmatch(endpoint)
    if match is None:
        raise InputError(f"{option} {endpoint}: must be PROTOCOL/ADDRESS, such as tcp/127.0.0.1:7447")
    if match["protocol"] not in _LOCAL and _HOST_AND_PORT.fullmatch(match["address"]) is None:
        raise InputError(
            f"{option} {endpoint}: must be one endpoint, PROTOCOL/HOST:PORT, such as tcp/127.0.0.1:7447"
        )
    if kind == "certificate":
        if match["protocol"] != "tls":
            raise InputError(
                f"{option} {endpoint}: with these keys it must be tls/, such as tls/{match['address']}"
            )
        return
    if match["protocol"] == "tls":
        raise InputError(
            f"{option} {endpoint}: tls/ needs certificates: --keys DIR, made by mdms keys DIR SCENE"
        )
    if not insecure:
        _check_reach(endpoint, kind, option)


def check_opened(
    endpoint: str, addresses: Sequence[str], kind: Kind | None, *, insecure: bool, option: Option = "--listen"
) -> None:
    """Check that the addresses on which a session listens are as private as the requested endpoint.

    Args:
        endpoint: Requested endpoint.
        addresses: Addresses on which the session listens.
        kind: Kind of credentials; None: no credentials.
        insecure: Accept an endpoint that any peer can reach.
        option: Option that names the endpoint.

    Raises:
        InputError: An address is reachable from more than is allowed, or Zenoh names no address.
    """
    if insecure or kind == "certificate":
        return
    if not addresses:
        raise InputError(
            f"{option} {endpoint}: Zenoh doesn't report the address then: use tcp/, or --insecure"
        )
    for address in addresses:
        _check_reach(address, kind, option)


def _check_reach(endpoint: str, kind: Kind | None, option: Option) -> None:
    """Raise InputError if an endpoint is reachable from more than is allowed."""
    if is_local(endpoint):
        if option == "--join" and kind is None and not endpoint.startswith(f"{_SOCKET}/"):
            raise InputError(
                f"{option} {endpoint}: anybody on this host could drive the run's wheels: use {_SOCKET}/PATH, or "
                "--keys DIR (mdms keys DIR SCENE makes them), or --insecure"
            )
        return
    if kind == "password":
        raise InputError(
            f"{option} {endpoint}: leaves this host, and with passwords messages are not encrypted: use "
            "certificates (mdms keys without --passwords), or --insecure"
        )
    done = "listen to the run and disturb it" if option == "--listen" else "join"
    raise InputError(
        f"{option} {endpoint}: leaves this host, and anybody who reaches it could {done}: use --keys DIR "
        "(mdms keys DIR SCENE makes them), or --insecure"
    )


def is_local(endpoint: str) -> bool:
    """Whether an endpoint is reachable from this host only, by its protocol or by all addresses of its host's name."""
    protocol, _, address = endpoint.partition("/")
    if protocol in _LOCAL:
        return True
    interface = _INTERFACE.search(address)
    return (interface is None or interface["interface"] == "lo") and _is_loopback(host_of(endpoint))


def host_of(endpoint: str) -> str:
    """Return the host of ``PROTOCOL/HOST:PORT``, which may have Zenoh's metadata and configuration appended."""
    address = endpoint.partition("/")[2]
    return address.partition("#")[0].partition("?")[0].rpartition(":")[0].strip("[]")


def loopback_address(endpoint: str) -> str:
    """Return the endpoint with loopback in place of the wildcard address, for processes of the same host."""
    for everywhere, loopback in (("/0.0.0.0:", "/127.0.0.1:"), ("/[::]:", "/[::1]:")):
        endpoint = endpoint.replace(everywhere, loopback, 1)
    return endpoint


def _is_loopback(host: str) -> bool:
    """Whether a host's name stands for loopback addresses alone."""
    try:
        found = socket.getaddrinfo(host, None) if host else []
        return bool(found) and all(ipaddress.ip_address(one[4][0]).is_loopback for one in found)
    except (OSError, ValueError):
        return False


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


@final
@dataclass(frozen=True, slots=True)
class PlannedProcess:
    """A process to start, or a part of this process.

    Attributes:
        name: Name in process lists and messages.
        role: ``plant`` or ``cells``.
        where: ``this process``, ``a thread of this process`` or ``a process of its own``.
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
    """

    run: str
    scene: str
    setting: Processes
    workers: int
    transport: Transport
    wire: WireFormat
    partition: Partition
    processes: tuple[PlannedProcess, ...]

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
    if rule := too_many_workers(workers, len(lattice)):
        raise InputError(f"--processes {setting}: {rule}")
    about = _about_keys(options)
    kind = None if about is None else about.kind
    asked: dict[Option, str | None] = {"--listen": options.listen, "--join": options.join}
    for option, endpoint in asked.items():
        if endpoint is not None:
            check_listening(endpoint, kind, insecure=options.insecure, option=option)
    _check(options, scene, workers)
    try:
        partition = Partition.even(lattice, max(1, workers))
    except PartitionError:
        raise InputError(
            f"--processes {workers}: must be each or 0..{len(lattice)}, the number of cells"
        ) from None
    return Plan(
        run=run,
        scene=scene.name,
        setting=setting,
        workers=workers,
        transport=options.transport,
        wire=options.wire or _wire(options, setting, about),
        partition=partition,
        processes=tuple(
            _processes_of(partition, workers, setting, _endpoints(options, kind), scene.stall.start_s)
        ),
    )


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


def _wire(options: RunOptions, setting: Processes, about: KeyManifest | None) -> WireFormat:
    """Return the wire format of a run whose options name none."""
    if about is not None:
        return about.wire
    if setting != "each":
        return "packed"
    # Whoever is given an address may be any tool, or hardware: these read maps of single cells.
    return "relayed" if options.listen is None and options.join is None else "per_cell"


def _endpoints(options: RunOptions, kind: Literal["certificate", "password"] | None) -> _Endpoints:
    if options.transport == "memory":
        return None, None
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
    partition: Partition, workers: int, setting: Processes, endpoints: _Endpoints, start_s: float
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
    where = "a separate process" if workers else "a thread of this process"
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
