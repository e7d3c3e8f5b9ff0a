"""The parts of a running system, put together: the plant's endpoints, the lockstep's host, and the cells."""

from __future__ import annotations

import threading
import time
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self, final

from bus.errors import BusError
from deploy.workers.groups import WorkerGroup, WorkerProcesses, WorkerThread
from deploy.workers.plan import Plan, RunOptions, host_of, loopback_address
from deploy.workers.worker import ResumePoint, WorkerConfig, cell_faults, make_controller, open_session

if TYPE_CHECKING:
    from bus.lockstep import Coordinator, MessageCounters
    from bus.lockstep.registers import RegisterRequest
    from bus.sensors import SensorSchema
    from bus.transports.base import Endpoint
    from bus.transports.zenoh.access_log import AccessLogMonitor
    from bus.transports.zenoh.requests import RequestQueue
    from deploy.scenes.scene import Scene
    from deploy.security.keyring import Keyring
    from deploy.workers.access import Access
    from plant.array import CellArray

_STOP_S = 5.0
"""Wall time that the cells get to leave when they are told to stop."""

_LEAVE_S = 0.5
"""The least that they get from leaving the bus to their end."""

_LATE = 0.25
"""Of the time until every cell must be ready, that workers which are not there get to say why."""

_WATCH_S = 0.05
"""How often the barrier's watch looks whether it is still needed."""


@final
class System:
    """One run's endpoints, host and cells; leaving the context ends whatever was started.

    Args:
        plan: What to start.
        scene: What runs.
        options: How; of these the endpoints, the keys, and whether strangers may come in.

    Attributes:
        locator: Where listeners and operators connect; empty before ``open`` and where nobody can.
        refusals: What the plant's sessions refuse, where they don't let anybody in.
        unreported: Cells (indices) that took part to the end and whose counts did not come in time.

    Raises:
        InputError: The keys don't fit, or don't hold.
    """

    def __init__(self, plan: Plan, scene: Scene, options: RunOptions) -> None:
        self._plan = plan
        self._scene = scene
        self._options = options
        self._keyring = None if options.keys is None else _keyring(options.keys, plan, options)
        self.refusals: AccessLogMonitor | None = None
        self._access: Access | None = None
        self._endpoint: Endpoint | None = None
        self._cells: WorkerGroup | None = None
        self.locator = ""
        self.unreported: list[int] = []
        self._host: Coordinator | None = None
        self._order: WorkerConfig | None = None
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
        """Open the plant's endpoints.

        Raises:
            InputError: A port is in use, or an endpoint makes no sense, or more can reach it than may.
        """
        if self._plan.transport == "memory":
            from bus.transports.memory import MemoryBus

            bus = MemoryBus()
            self._endpoint = bus.endpoint()
            self._cells = WorkerThread(bus.endpoint())
            return
        from deploy.workers.access import Access

        self._access = Access(self._plan, self._scene.stall, self._options, self._keyring)
        hub = self._access.open()
        self._endpoint, self.refusals, self.locator = hub, hub.refusals, self._access.locator
        self._cells = self._processes or WorkerThread(
            open_session(self._access.join, self._keys(), 0, self._scene.stall)
        )

    def _keys(self) -> tuple[Path, ...]:
        return () if self._keyring is None else self._keyring.of_cells(self._plan.cut)

    def start(
        self,
        array: CellArray,
        readings: SensorSchema,
        wanted: tuple[RegisterRequest, ...] = (),
        *,
        metered: bool = False,
        live: bool = False,
        keeps: bool = False,
        resumed: ResumePoint | None = None,
        counted: MessageCounters | None = None,
    ) -> Coordinator:
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
        from bus.lockstep import Coordinator

        assert self._endpoint is not None
        assert self._cells is not None
        scene, plan = self._scene, self._plan
        order = WorkerConfig(
            scene=scene,
            array=array,
            partition=plan.partition,
            wire=plan.wire,
            run=plan.run,
            connect="" if self._access is None else self._access.join,
            sensors=readings,
            register_requests=wanted,
            metered=metered,
            byte_accurate_links=live,
            joins_running=False,
            keys=self._keys(),
            own_process=plan.workers > 0,
            snapshots=keeps,
            resumed=resumed,
        )
        host = self._host = Coordinator(
            self._endpoint,
            plan.partition,
            plan.wire,
            run=plan.run,
            readings=readings,
            message=make_controller(scene, cell_faults(scene), live=live).link_type,
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
        self._cells.restart(replace(self._order, joins_running=True), shard)

    def ended(self, shard: int) -> bool:
        """Whether the process of a shard has ended."""
        assert self._cells is not None
        return self._cells.ended(shard)

    def questions(self, key: str) -> RequestQueue | None:
        """Where others may ask something while the run goes on; None where nobody can."""
        return None if self._access is None else self._access.questions(key)

    def _barrier(self, host: Coordinator, endpoint: Endpoint, cells: WorkerGroup) -> None:
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
        deadline = time.monotonic() + self._scene.stall.start_s
        try:
            host.barrier()
        except BusError as error:
            failed = error
        finally:
            over.set()
            watcher.join()
        if failed and not trouble.is_set():
            # A worker that began late on a busy machine finds only now that its program doesn't return.
            late = deadline + _LATE * self._scene.stall.start_s
            while host.absent(0.0) and time.monotonic() < late and not cells.trouble(_WATCH_S):
                pass
            deadline = late
        if failed or trouble.is_set():
            # Which program is named must not depend on which worker was faster: the others get until the deadline.
            while cells.programs_failed() and time.monotonic() < deadline:
                if all(cells.ended(shard) for shard in host.absent(_WATCH_S)):
                    break
            cells.check()  # why a worker is not there says more than that it is not
        if failed:
            raise failed

    def explain(self) -> str:
        """Tracebacks of the workers that raised, or an empty string."""
        if self._cells is None:
            return ""
        self._cells.trouble(_WATCH_S)
        return self._cells.details()

    def stop(self, detail: str = "") -> MessageCounters | None:
        """Tell the cells to stop, end those that do not, and close the endpoint; a second call does nothing.

        Returns:
            The messages of all sides; None if the lockstep never was.
        """
        if self._stopped:
            return None
        self._stopped = True
        counts: MessageCounters | None = None
        # Cells that wait for the start don't listen for the stop.
        deadline = time.monotonic() + (_STOP_S if self._running else 0.0)
        try:
            if self._host is not None:
                counts = self._host.stop(detail, deadline - time.monotonic())
                self.unreported = self._host.unreported if self._running else []
        finally:
            try:
                for side in (self._cells, self._processes):
                    if side is not None:
                        side.close(max(deadline - time.monotonic(), _LEAVE_S) if self._running else 0.0)
            finally:
                for opened in (self._access, self._endpoint):
                    if opened is not None:
                        opened.close()
        return counts


def _keyring(folder: Path, plan: Plan, options: RunOptions) -> Keyring:
    from deploy.security.keyring import Keyring

    keyring = Keyring(folder)
    for endpoint in (options.listen, options.join):
        keyring.check(plan.cut, None if endpoint is None else host_of(loopback_address(endpoint)))
    return keyring
