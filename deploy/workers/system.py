"""Parts of a running system: endpoints of the plant, coordinator of the lockstep, and workers."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Literal, Self, final

from bus.errors import BusError
from bus.wire.keys import plant_key
from deploy.control.waiting import WaitingControl
from deploy.util.formatting import say
from deploy.workers.external import ExternalWorkers
from deploy.workers.groups import WorkerGroup, WorkerProcesses, WorkerThread
from deploy.workers.listening import host_of, loopback_address
from deploy.workers.plan import Plan, RunOptions
from deploy.workers.status import RunStatus
from deploy.workers.worker import (
    ResumePoint,
    WorkerConfig,
    cell_faults,
    compile_program,
    make_controller,
    modules_of,
    open_session,
)

if TYPE_CHECKING:
    from bus.lockstep import Coordinator, MessageCounters
    from bus.lockstep.registers import RegisterRequest
    from bus.sensors import SensorSchema
    from bus.transports.base import Endpoint
    from bus.transports.zenoh.access_log import AccessLogMonitor
    from bus.transports.zenoh.requests import RequestQueue, Responder
    from deploy.scenes.scene import Scene
    from deploy.security.keyring import Keyring
    from deploy.workers.access import Access
    from deploy.workers.cluster import DaskCluster
    from deploy.workers.presence import Presence
    from plant.array import CellArray

_STOP_S = 5.0
"""Wall time that the cells get to leave after the stop request."""

_LEAVE_S = 0.5
"""Least wall time from leaving the bus to the end of a worker."""

_LATE = 0.25
"""Extra time for absent workers to report a failure, as a share of the time until every cell must be ready."""

_WATCH_S = 0.05
"""Period at which the barrier's watch checks for its end."""


@final
class System:
    """Endpoints, coordinator and workers of one run; leaving the context ends everything that was started.

    Args:
        plan: Plan of the run.
        scene: Scene of the run.
        options: Options of the run, for the endpoints, the keys and ``insecure``.
        live: Simulate serial lines byte by byte, so that faults can be injected at run time.

    Attributes:
        locator: Endpoint for listeners and operators; empty before ``open`` and with the memory transport.
        status: Status of the run, which operators may ask for; None before ``open`` and with the memory transport.
        refusals: Monitor of denials by the plant's sessions; None before ``open`` and without access control.
        coordinator: Coordinator of the lockstep; None before ``start``.
        waiting: Control server of the time before the cells are ready; None before ``open``, and where the plant starts
            the cells itself.
        while_waiting: Called now and then while the cells are waited for; None: nothing is.
        unreported: Indices of the cells that were alive at the end and whose counters did not arrive in time.

    Raises:
        InputError: The keys don't fit the run, or are not valid.
    """

    def __init__(self, plan: Plan, scene: Scene, options: RunOptions, *, live: bool = False) -> None:
        self._plan = plan
        self._live = live
        self._scene = scene
        self._options = options
        self._keyring = None if options.keys is None else _keyring(options.keys, plan, options)
        self.refusals: AccessLogMonitor | None = None
        self._access: Access | None = None
        self._endpoint: Endpoint | None = None
        self._cells: WorkerGroup | None = None
        self.locator = ""
        self.unreported: list[int] = []
        self.coordinator: Coordinator | None = None
        self._order: WorkerConfig | None = None
        self._running = False
        self._stopped = False
        # Begun at once: the workers' parent imports what they need while this process gets its kernels.
        forked = plan.workers > 0 and not plan.external
        self._processes = WorkerProcesses(plan, modules_of(scene, live=live)) if forked else None
        if forked:
            compile_program(scene)  # once, and before deadlines: workers load it from disk
        self._cluster = _connected(plan, options)
        self._external: ExternalWorkers | None = None
        self._presence: Presence | None = None
        self._responder: Responder | None = None
        self.status: RunStatus | None = None
        self.waiting: WaitingControl | None = None
        self.while_waiting: Callable[[], None] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def open(self, check: Callable[[], None] | None = None) -> None:
        """Open the plant's endpoints.

        Args:
            check: Called while a router is waited for; may raise to end the wait.

        Raises:
            InputError: A port is in use, or an endpoint is invalid or reachable from more than is allowed.
            DeployError: No router listens in time.
        """
        if self._plan.transport == "memory":
            from bus.transports.memory import MemoryBus

            bus = MemoryBus()
            self._endpoint = bus.endpoint()
            self._cells = WorkerThread(bus.endpoint())
            return
        from deploy.workers.access import Access
        from deploy.workers.presence import Presence

        self._access = Access(self._plan, self._scene.stall, self._options, self._keyring)
        hub = self._access.open(check)
        self._endpoint, self.refusals, self.locator = hub, hub.refusals, self._access.locator
        presence = self._presence = Presence(hub, self._plan.run, self._plan.partition)
        if self._plan.external:
            external = self._external = ExternalWorkers(self._plan, self._scene, hub, presence, say)
            self.waiting = WaitingControl(
                self._plan.run,
                self._access.questions(plant_key(self._plan.run, "operator")),
                external.awaited,
                speed=self._options.realtime,
                paused=self._options.paused,
            )
        self._cells = (
            self._placed()
            or self._external
            or self._processes
            or WorkerThread(open_session(self._access.join, self._keys(), 0, self._scene.stall))
        )
        self._serve_status(self._access, presence)

    def _serve_status(self, access: Access, presence: Presence) -> None:
        """Answer requests for the status of the run."""
        from bus.transports.zenoh.requests import Responder

        external = self._external
        self.status = RunStatus(
            self._plan,
            self._scene.duration_s,
            presence,
            None if external is None else external.holder,
        )
        queue = access.questions(plant_key(self._plan.run, "status"))
        self._responder = Responder({queue: self.status.answer})

    def _placed(self) -> WorkerGroup | None:
        """Return the group of processes that a Dask cluster runs; None without a cluster."""
        if self._cluster is None:
            return None
        from deploy.workers.cluster_group import ClusterWorkers

        assert self._external is not None, (
            "this is a bug: processes of a Dask cluster join as those of others"
        )
        group = ClusterWorkers(self._cluster, self._plan, self._options.keys, self._external, self.join)
        self._cluster = None  # the group's from now on
        return group

    @property
    def join(self) -> str:
        """Endpoint to which processes of cells connect; empty before ``open`` and with the memory transport."""
        return "" if self._access is None else self._access.join

    def _keys(self) -> tuple[Path, ...]:
        if self._keyring is None or self._plan.external:
            return ()
        return self._keyring.of_cells(self._plan.cut)

    def start(
        self,
        array: CellArray,
        readings: SensorSchema,
        wanted: tuple[RegisterRequest, ...] = (),
        *,
        metered: bool = False,
        keeps: bool = False,
        messages: bool = False,
        traced: bool = False,
        resumed: ResumePoint | None = None,
        counted: MessageCounters | None = None,
    ) -> Coordinator:
        """Start the cells and wait until all of them are ready.

        Args:
            array: Cells of the array.
            readings: Schema of the cells' sensors.
            wanted: Registers that the cells publish.
            metered: Count the cells' messages.
            keeps: Let the coordinator request snapshots.
            messages: Let the cells publish their messages as registers.
            traced: Let the cells record what their programs read and send, as registers.
            resumed: Resume point; None: the cells start at tick 0.
            counted: Counters of all sides at the resume point.

        Raises:
            DeployError: A worker failed during the start; the message names the worker and the cause.
            BusError: Cells were not ready in time; the message names the cells.
            EndedByOperator: An operator has ended the run meanwhile.
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
            byte_accurate_links=self._live,
            joins_running=False,
            keys=self._keys(),
            own_process=self._processes is not None,
            snapshots=keeps,
            messages=messages,
            traced=traced,
            resumed=resumed,
        )
        host = self.coordinator = Coordinator(
            self._endpoint,
            plan.partition,
            plan.wire,
            run=plan.run,
            readings=readings,
            message=make_controller(scene, cell_faults(scene), live=self._live).link_type,
            wanted=wanted,
            stall=scene.stall,
            latency=scene.bus,
            keeps=keeps,
        )
        self._order = order
        if resumed is not None and counted is not None:
            host.resume(resumed.tick, resumed.dead, counted, resumed.relayed)
        self._cells.start(order)
        self._barrier(host, self._endpoint, self._cells)
        if self._external is not None:
            self._external.begin()
        self._running = True
        return host

    def restart(self, shard: int) -> None:
        """Restart the process of a shard, whose cells then rejoin the run."""
        assert self._cells is not None
        assert self._order is not None
        # in a run that was resumed, too, cells start as after power-on: the resume point has passed
        self._cells.restart(replace(self._order, joins_running=True, resumed=None), shard)

    def ended(self, shard: int) -> bool:
        """Whether the process of a shard has ended."""
        assert self._cells is not None
        return self._cells.ended(shard)

    def questions(self, leaf: Literal["operator", "view"]) -> RequestQueue | None:
        """Return the queue of operators' or viewers' requests; None with the memory transport."""
        if self.waiting is not None and leaf == "operator":
            return self.waiting.queue
        return None if self._access is None else self._access.questions(plant_key(self._plan.run, leaf))

    def _barrier(self, host: Coordinator, endpoint: Endpoint, cells: WorkerGroup) -> None:
        """Wait at the coordinator's barrier, until all cells are ready or a worker fails."""
        over, trouble = threading.Event(), threading.Event()

        def watch() -> None:
            while not over.is_set():
                # Asked first, so that the answer to a stop goes out while the cells are looked at once more.
                ended = self._answer_requests()
                if cells.trouble(_WATCH_S) or ended:
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
        if self.waiting is not None and self.waiting.ended is not None:
            raise self.waiting.ended
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
            raise failed if self._external is None else self._external.explained(failed)

    def _answer_requests(self) -> bool:
        """Answer operators while the cells are waited for; return whether one of them ends the run."""
        if self.while_waiting is not None:
            self.while_waiting()
        if self.waiting is None:
            return False
        self.waiting.serve()
        return self.waiting.ended is not None

    def explain(self) -> str:
        """Return the tracebacks of the workers that raised, or an empty string."""
        if self._cells is None:
            return ""
        self._cells.trouble(_WATCH_S)
        return self._cells.details()

    def stop(self, detail: str = "") -> MessageCounters | None:
        """Send the stop request, end remaining workers, and close the endpoints; a second call does nothing.

        Returns:
            Counters of all sides; None if the lockstep was never started.
        """
        if self._stopped:
            return None
        self._stopped = True
        counts: MessageCounters | None = None
        # Cells that wait for the start don't listen for the stop.
        deadline = time.monotonic() + (_STOP_S if self._running else 0.0)
        try:
            if self.coordinator is not None:
                counts = self.coordinator.stop(detail, deadline - time.monotonic())
                self.unreported = self.coordinator.unreported if self._running else []
        finally:
            try:
                if self._responder is not None:
                    self._responder.close()
                for side in (self._cells, self._processes):
                    if side is not None:
                        side.close(max(deadline - time.monotonic(), _LEAVE_S) if self._running else 0.0)
            finally:
                for opened in (self._cluster, self._access, self._endpoint):
                    if opened is not None:
                        opened.close()
        return counts


def _connected(plan: Plan, options: RunOptions) -> DaskCluster | None:
    """Connect to the requested Dask cluster; None where none is requested.

    Raises:
        InputError: There is no such cluster, or it has fewer workers than the run has shards.
    """
    if options.cluster is None:
        return None
    from deploy.workers.cluster import connect_for

    return connect_for(options.cluster, plan.workers, insecure=options.insecure)


def _keyring(folder: Path, plan: Plan, options: RunOptions) -> Keyring:
    from deploy.security.keyring import Keyring

    keyring = Keyring(folder)
    for endpoint in (options.listen, options.join):
        host = None if endpoint is None else host_of(loopback_address(endpoint))
        keyring.check(plan.cut, host, plant_alone=plan.external)
    return keyring
