"""The parts of a running system, put together: the plant's endpoint, the lockstep's host, and the cells."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self, final

from bus.errors import BusError, TransportError
from deploy.errors import InputError
from deploy.processes.cells_side import CellsSide, WorkerProcesses, WorkerThread
from deploy.processes.listening import host_of, near
from deploy.processes.plan import Plan
from deploy.processes.worker import Order, Resumed, connected, controller_of, faults_of

if TYPE_CHECKING:
    from bus.lockstep import Counts, Host
    from bus.readings import Readings
    from bus.registers import Wanted
    from bus.transport import Endpoint
    from bus.transports.zenoh.questions import Questions
    from bus.transports.zenoh.refusals import Watch
    from deploy.keys.keyring import Keyring
    from deploy.scene import Scene
    from plant.array import CellArray

_STOP_S = 2.0
"""Wall time that the cells get to leave when they are told to stop."""

_LEAVE_S = 0.5
"""The least that they get from leaving the bus to their end."""

_WATCH_S = 0.05
"""How often the barrier's watch looks whether it is still needed."""


@final
class System:
    """One run's endpoint, host and cells; leaving the context ends whatever was started.

    Args:
        plan: What to start.
        scene: What runs.
        listen: Endpoint on which the plant listens; None: a free loopback port.
        keys: Folder with the run's keys; None: anybody is let in.

    Attributes:
        locator: Where it listens; empty before ``open`` and where it doesn't.
        refusals: What the plant's session refuses, where it doesn't let anybody in.

    Raises:
        InputError: The keys don't fit, or don't hold.
    """

    def __init__(self, plan: Plan, scene: Scene, listen: str | None, keys: Path | None = None) -> None:
        self._plan = plan
        self._scene = scene
        self._listen = listen
        self._keyring = None if keys is None else _keyring(keys, plan, listen)
        self.refusals: Watch | None = None
        self._endpoint: Endpoint | None = None
        self._cells: CellsSide | None = None
        self.locator = ""
        self._host: Host | None = None
        self._order: Order | None = None
        self._running = False
        self._stopped = False
        # Begun at once: the workers' parent imports what they need while this process gets its kernels.
        self._processes = WorkerProcesses(plan) if plan.workers else None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def open(self) -> None:
        """Open the plant's endpoint.

        Raises:
            InputError: The port is in use, or the endpoint makes no sense.
        """
        if self._plan.transport == "memory":
            from bus.transports.memory import MemoryBus

            bus = MemoryBus()
            self._endpoint = bus.endpoint()
            self._cells = WorkerThread(bus.endpoint())
            return
        from bus.transports.zenoh import open_hub

        try:
            gate = None if self._keyring is None else self._keyring.gate(self._plan.cut)
            hub = open_hub(self._listen, lease_s=self._scene.stall.lease_s, gate=gate)
        except TransportError as error:
            raise InputError(str(error)) from None
        self._endpoint, self.locator, self.refusals = hub, near(hub.locator), hub.refusals
        self._cells = self._processes or WorkerThread(
            connected(self.locator, self._keys(), 0, self._scene.stall)
        )

    def _keys(self) -> tuple[Path, ...]:
        return () if self._keyring is None else self._keyring.of_cells(self._plan.cut)

    def start(
        self,
        array: CellArray,
        readings: Readings,
        wanted: tuple[Wanted, ...] = (),
        *,
        metered: bool = False,
        live: bool = False,
        keeps: bool = False,
        resumed: Resumed | None = None,
        counted: Counts | None = None,
    ) -> Host:
        """Start the cells and wait until all of them are ready.

        Args:
            array: The cells that exist.
            readings: What they can read.
            wanted: Registers that the cells are to show.
            metered: Have the cells count their messages.
            live: Let faults come while it runs, over serial lines too.
            keeps: Have them told that they may be asked what they remember.
            resumed: Where they go on; None: they begin.
            counted: What all sides had counted by then.

        Raises:
            DeployError: A worker failed on the way; says which and why.
            BusError: Somebody was not ready in time; names who.
        """
        from bus.lockstep import Host

        assert self._endpoint is not None
        assert self._cells is not None
        scene, plan = self._scene, self._plan
        order = Order(
            scene=scene,
            array=array,
            partition=plan.partition,
            wire=plan.wire,
            run=plan.run,
            connect=self.locator,
            readings=readings,
            wanted=wanted,
            metered=metered,
            live=live,
            joins=False,
            keys=self._keys(),
            alone=plan.workers > 0,
            keeps=keeps,
            resumed=resumed,
        )
        host = self._host = Host(
            self._endpoint,
            plan.partition,
            plan.wire,
            run=plan.run,
            readings=readings,
            message=controller_of(scene, faults_of(scene), live=live).message,
            wanted=wanted,
            stall=scene.stall,
            keeps=keeps,
        )
        self._order = order
        if resumed is not None and counted is not None:
            host.resume(resumed.tick, resumed.dead, counted)
        self._cells.start(order)
        self._barrier(host, self._endpoint, self._cells)
        self._running = True
        return host

    def restart(self, shard: int) -> None:
        """Start the process of a shard anew, to take part in the run that goes on."""
        assert self._cells is not None
        assert self._order is not None
        self._cells.restart(replace(self._order, joins=True), shard)

    def ended(self, shard: int) -> bool:
        """Whether the process of a shard has ended."""
        assert self._cells is not None
        return self._cells.ended(shard)

    def questions(self, key: str) -> Questions | None:
        """Where others may ask something while the run goes on; None where nobody can."""
        if self._plan.transport == "memory":
            return None
        from bus.transports.zenoh import ZenohEndpoint
        from bus.transports.zenoh.questions import Questions

        assert isinstance(self._endpoint, ZenohEndpoint)
        return Questions(self._endpoint, key)

    def _barrier(self, host: Host, endpoint: Endpoint, cells: CellsSide) -> None:
        """The host's barrier, cut short by a worker that fails."""
        over, trouble = threading.Event(), threading.Event()

        def watch() -> None:
            while not over.is_set():
                if cells.trouble(_WATCH_S):
                    trouble.set()
                    endpoint.wake()
                    return

        watcher = threading.Thread(target=watch, name="start-up watch", daemon=True)
        watcher.start()
        failed: BusError | None = None
        try:
            host.barrier()
        except BusError as error:
            failed = error
        finally:
            over.set()
            watcher.join()
        if failed or trouble.is_set():
            cells.check()  # why a worker is not there says more than that it is not
        if failed:
            raise failed

    def explain(self) -> str:
        """Tracebacks of the workers that raised, or an empty string."""
        if self._cells is None:
            return ""
        self._cells.trouble(_WATCH_S)
        return self._cells.details()

    def stop(self, detail: str = "") -> Counts | None:
        """Tell the cells to stop, end those that do not, and close the endpoint; a second call does nothing.

        Returns:
            The messages of all sides; None if the lockstep never was.
        """
        if self._stopped:
            return None
        self._stopped = True
        counts: Counts | None = None
        # Cells that wait for the start don't listen for the stop.
        deadline = time.monotonic() + (_STOP_S if self._running else 0.0)
        try:
            if self._host is not None:
                counts = self._host.stop(detail, deadline - time.monotonic())
        finally:
            try:
                for side in (self._cells, self._processes):
                    if side is not None:
                        side.close(max(deadline - time.monotonic(), _LEAVE_S) if self._running else 0.0)
            finally:
                if self._endpoint is not None:
                    self._endpoint.close()
        return counts


def _keyring(folder: Path, plan: Plan, listen: str | None) -> Keyring:
    from deploy.keys.keyring import Keyring

    keyring = Keyring(folder)
    keyring.check(plan.cut, None if listen is None else host_of(near(listen)))
    return keyring
