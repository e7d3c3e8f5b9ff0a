"""Worker of a run: the agents of one shard, from loading the firmware to leaving the bus."""

from __future__ import annotations

import os
import signal
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import TYPE_CHECKING, Final, NamedTuple, final

from bus.partition import Partition
from bus.transports.base import Endpoint
from deploy.scenes.fault_schedule import Deaths, in_run_faults, of_cells, permanent_crashes
from deploy.workers import cell_output, debugger

if TYPE_CHECKING:
    from bus.lockstep import Participant, WireFormat
    from bus.lockstep.registers import RegisterRequest
    from bus.lockstep.snapshots import MessageBytes
    from bus.sensors import SensorSchema
    from bus.spec import StallSpec
    from cell_firmware.agent import ShardResult
    from cell_firmware.build import CellFaults
    from cell_firmware.controller import Controller
    from cell_firmware.effects.base import ShardContext
    from cell_firmware.firmware import Firmware
    from cell_firmware.shard import Shard
    from deploy.scenes.scene import Scene
    from plant.array import CellArray
    from plant.solvers.thread_pool import ThreadPool

_BEGIN: Final = 0.6
"""Time for the ``init`` of a shard's programs, as a share of the time until every cell must be ready."""

_THREAD_CELLS: Final = 10_000
"""Fewest cells of a thread: waking it takes as long as stepping some thousand."""


@final
@dataclass(frozen=True, slots=True, eq=False)
class ResumePoint:
    """Resume point of the cells' side of a run.

    Attributes:
        tick: First tick to run.
        dead: Indices of the cells that were dead before this tick.
        states: State of the cells, by shard; only shards with a live cell.
        links: Messages that were on their way to a shard, by shard; only shards with a live cell.
        relayed: Messages that the coordinator had not passed on, by the tick in which they were sent.
    """

    tick: int
    dead: tuple[int, ...]
    states: Mapping[int, bytes]
    links: Mapping[int, Sequence[MessageBytes]]
    relayed: Mapping[int, MessageBytes]


@final
@dataclass(frozen=True, slots=True, eq=False)
class WorkerConfig:
    """Configuration of every worker of a run; a call with a shard's number runs the worker.

    Attributes:
        scene: Scene of the run.
        array: Cells of the array.
        partition: Cells of each shard.
        wire: Wire format.
        run: Name of the run on the bus.
        connect: Endpoint on which the plant listens.
        sensors: Schema of the cells' sensors.
        register_requests: Registers that the cells publish.
        metered: Whether the cells' messages are counted.
        byte_accurate_links: Whether serial lines are simulated byte by byte, so that faults can be injected at run
            time.
        joins_running: Whether the worker joins a run in progress.
        keys: Folder of each shard's role, named after the role; empty without keys.
        own_process: Whether a worker has its own process, which ends with a scheduled crash of all its cells.
        snapshots: Whether the coordinator may request snapshots.
        messages: Whether the cells publish their messages as registers.
        traced: Whether the cells record what their programs read and send, as registers.
        resumed: Resume point; None: the cells start at tick 0.
        killed: Whether a process of its own kills itself at the scheduled crash of all its cells; else it ends well.
    """

    scene: Scene
    array: CellArray
    partition: Partition
    wire: WireFormat
    run: str
    connect: str
    sensors: SensorSchema
    register_requests: tuple[RegisterRequest, ...]
    metered: bool
    byte_accurate_links: bool
    joins_running: bool
    keys: tuple[Path, ...]
    own_process: bool
    snapshots: bool = False
    messages: bool = False
    traced: bool = False
    resumed: ResumePoint | None = None
    killed: bool = True

    def __call__(self, shard: int, built: BuiltShard | None = None) -> None:
        """Open a session, run the shard's agents, and close the session.

        Args:
            shard: Number of the shard.
            built: The shard; None: it is built here.
        """
        endpoint = open_session(self.connect, self.keys, shard, self.scene.stall)
        try:
            serve(self, shard, endpoint, built)
        finally:
            endpoint.close()


def open_session(connect: str, keys: tuple[Path, ...], shard: int, stall: StallSpec) -> Endpoint:
    """Open a shard's session, with the keys of the shard's role if the run has keys."""
    from bus.transports.zenoh import open_client

    if not keys:
        return open_client(connect, lease_s=stall.lease_s, timeout_s=stall.start_s)
    from deploy.security.keyring import identity_of

    identity = identity_of(keys[shard], keys[shard].name)
    return open_client(connect, lease_s=stall.lease_s, timeout_s=stall.start_s, identity=identity)


class BuiltShard(NamedTuple):
    """A shard before tick 0.

    Attributes:
        cells: The shard.
        site: Context of its cells.
        records: Record types in the states of its programs, beyond plain values.
    """

    cells: Shard
    site: ShardContext
    records: tuple[type, ...]


def serve(
    order: WorkerConfig, shard: int, endpoint: Endpoint, built: BuiltShard | None = None
) -> ShardResult | None:
    """Run the agents of one shard until the stop request or the death of all cells.

    Args:
        order: Configuration of the run's workers.
        shard: Number of the shard.
        endpoint: Opened endpoint of the shard.
        built: The shard; None: it is built here.

    Returns:
        How the shard ended; None if the run stopped before its first tick.

    Raises:
        FirmwareError: The firmware can't be loaded or initialised.
        BusError: The plant can't be reached, or has left.
    """
    debugger.install()
    with cell_output.naming_cells():
        return _serve(order, shard, endpoint, built)


def _serve(
    order: WorkerConfig, shard: int, endpoint: Endpoint, built: BuiltShard | None
) -> ShardResult | None:
    """Run the agents of one shard; see ``serve``."""
    import asyncio

    from bus.state import save_state
    from bus.transports.event_loop import TransportEventLoop
    from cell_firmware import agent
    from deploy.workers.overrun import Watchdog

    cells, site, records = begin_shard(order, shard) if built is None else built
    if order.snapshots:
        save_state(cells, records)  # a program whose memory can't be kept is told of before the run begins
    member = open_participant(order, shard, endpoint, cells)
    schedule = permanent_crashes(order.scene)
    for tick, dead in schedule.items():
        member.schedule_death(dead, tick)
    if order.resumed is not None:
        _recall(order.resumed, shard, cells, records, member)
    member.ready()
    first, ended = _first(order, member), None
    if first is not None:
        cells.start_at(first)
        inject = agent.injector(cells, site, order.partition.lattice)
        watched = partial(Watchdog, order.scene.stall.deadline_s, "stall.deadline_s")
        with asyncio.Runner(loop_factory=partial(TransportEventLoop, endpoint)) as runner:
            ended = runner.run(agent.run(cells, member, inject, records, first, watched))
        doomed = dead_by_schedule(order, shard, schedule, first + ended.ticks)
        # Whoever had no cells left from the beginning stays none the less: the start waits for all.
        absent = order.resumed is not None and shard not in order.resumed.states
        # Whoever goes earlier sometimes loses its last messages, and is missed at the start if all die in tick 0.
        confirmed = (doomed or absent) and member.confirmed(first + ended.ticks)
        if confirmed and order.own_process and order.killed:
            os.kill(os.getpid(), signal.SIGKILL)
    member.close()
    return ended


def open_participant(order: WorkerConfig, shard: int, endpoint: Endpoint, cells: Shard) -> Participant:
    """Open a shard's participant in the lockstep; call its ``ready`` next."""
    from bus.lockstep import Participant

    return Participant(
        endpoint,
        order.partition,
        shard,
        order.wire,
        run=order.run,
        readings=order.sensors,
        message=cells.message,
        stall=order.scene.stall,
        latency=order.scene.bus,
        wanted=order.register_requests,
        cell_counters=cells.counters,
        keeps=order.snapshots,
        joins=order.joins_running,
        direct=cells.is_brief,
    )


def begin_shard(order: WorkerConfig, shard: int) -> BuiltShard:
    """Build a shard, with a deadline for the programs' ``init``.

    Raises:
        FirmwareError: The firmware can't be loaded or initialised, or an ``init`` does not return.
    """
    from cell_firmware.errors import FirmwareFailed
    from deploy.workers.overrun import Watchdog

    made: SimpleQueue[BuiltShard | BaseException] = SimpleQueue()

    def hopeless(cell: tuple[int, int], problem: str, trace: str) -> None:
        made.put(FirmwareFailed(cell, 0, f"init: {problem}", trace))

    limit_s, rule = _BEGIN * order.scene.stall.start_s, f"{_BEGIN:g} of stall.start_s"
    with closing(Watchdog(limit_s, rule, hopeless=hopeless)) as watch:

        def make() -> None:
            try:
                with watch:
                    made.put(build_shard(order, shard))
            except BaseException as error:  # noqa: BLE001 - raised again in the shard's own thread
                made.put(error)

        # In another thread: an init that waits in C can't be interrupted, and must not keep this thread from saying so.
        Thread(target=make, name="init", daemon=True).start()
        found = made.get()
    if isinstance(found, BaseException):
        raise found
    return found


def _recall(
    resumed: ResumePoint, shard: int, cells: Shard, records: tuple[type, ...], member: Participant
) -> None:
    """Restore the cells of a shard from the resume point."""
    from bus.state import load_state

    if shard in resumed.states:
        load_state(cells, resumed.states[shard], records)
    member.resume(resumed.tick, resumed.dead, resumed.links.get(shard, ()))


def _first(order: WorkerConfig, member: Participant) -> int | None:
    """Return the first tick of a shard that is ready; None if the run stops before."""
    if order.resumed is None:
        return member.join() if order.joins_running else 0
    member.resumed()
    return order.resumed.tick


def make_controller(
    scene: Scene,
    faults: CellFaults | None = None,
    *,
    live: bool = False,
    metered: bool = False,
    traced: bool = False,
    firmware: Firmware | None = None,
) -> Controller:
    """Build the controller of a scene's cells.

    Args:
        scene: Scene of the run.
        faults: Result of ``cell_faults(scene)``.
        live: Whether serial lines are byte-accurate, so that faults can be injected at run time.
        metered: Whether the cell's messages are counted.
        traced: Whether the cell's messages are recorded.
        firmware: The cells' program; None: loaded here.
    """
    from cell_firmware.build import build_controller
    from cell_firmware.loader import load
    from deploy.scenes.motor_facts import motor_facts

    motors = motor_facts(scene.effects.motors)
    return build_controller(
        firmware or load(scene.cells),
        scene.cells,
        scene.effects,
        motors,
        scene.clocks(),
        faults=faults,
        live=live,
        metered=metered,
        traced=traced,
        seed=scene.seed,
    )


def kernels_of(scene: Scene, *, live: bool = False) -> tuple[str, ...]:
    """Return the modules of compiled kernels that a scene's cells use, without importing them.

    Args:
        scene: The scene.
        live: Whether faults can be injected at run time.
    """
    from cell_firmware.build import kernel_modules

    controller = make_controller(scene, cell_faults(scene), live=live, metered=True)
    return kernel_modules(controller, scene.effects)


def modules_of(scene: Scene, *, live: bool = False) -> tuple[str, ...]:
    """Return the modules that a scene's cells use beyond those of every scene: kernels and a bundled program.

    Args:
        scene: The scene.
        live: Whether faults can be injected at run time.
    """
    from cell_firmware.loader import BUNDLED

    kernels, program = kernels_of(scene, live=live), BUNDLED.get(scene.cells.firmware)
    return kernels if program is None else (*kernels, program.partition(":")[0])


def compile_program(scene: Scene) -> None:
    """Compile the step of a scene's cells, or load it from disk, where it is a scalar program: others then load it."""
    from cell_firmware.loader import load
    from cell_firmware.scalar_program import ScalarProgram

    program = load(scene.cells)
    if isinstance(program, ScalarProgram) and program.is_compiled():
        program.scalar_kernels()


def cell_faults(scene: Scene) -> CellFaults | None:
    """Return the faults of a scene that act in the cells; None without such faults."""
    injected = of_cells(in_run_faults(scene))
    if not injected:
        return None
    from cell_firmware.build import CellFaults

    return CellFaults(scene.lattice(), injected, scene.seed, scene.bus.link_ticks)


def build_shard(order: WorkerConfig, index: int) -> BuiltShard:
    """Build a shard."""
    from cell_firmware.cell import records_of
    from cell_firmware.effects.base import ShardContext
    from cell_firmware.firmware import Cells
    from cell_firmware.loader import load
    from cell_firmware.shard import FAULTS, Shard

    scene, array, readings = order.scene, order.array, order.sensors
    faults = cell_faults(scene)
    if order.byte_accurate_links:
        from cell_firmware.faults.attach import prepare

        prepare()
    firmware = load(scene.cells)
    controller = make_controller(
        scene,
        faults,
        live=order.byte_accurate_links,
        metered=order.metered,
        traced=order.traced,
        firmware=firmware,
    )
    cells, clocks = order.partition.cells(index), scene.clocks()
    site = ShardContext(
        cells,
        readings.sensors,
        controller.link_type,
        scene.seed,
        levels=readings.levels,
        said=controller.message_type,
        tick_ns=scene.tick_ns,
        clocks=None if clocks is None else clocks.clocks.take(cells),
    )
    stages = scene.effects.input_filters(site)
    if faults is not None:
        stages[FAULTS] = faults.stages(site)
    shard = Shard(
        controller,
        Cells.of(
            array.lattice,
            array.positions_m,
            scene.cells.period_s,
            scene.array.sensors_m,
            pitch_m=array.pitch_m,
        ),
        order.partition,
        index,
        stages,
        () if faults is None else faults.injected,
        link_ticks=scene.bus.link_ticks,
        threads=_threads(len(cells), order.partition.count),
    )
    shard.shows_messages = order.messages or order.byte_accurate_links
    return BuiltShard(shard, site, records_of(firmware))


def _threads(cells: int, workers: int) -> ThreadPool | None:
    """Return threads for the cells of a shard, as many as it has processors; None for the calling one alone."""
    if cells < 2 * _THREAD_CELLS:
        return None
    from plant.solvers.thread_pool import ThreadPool, processors

    threads = min(processors() // workers, cells // _THREAD_CELLS)
    return ThreadPool(threads) if threads > 1 else None


def dead_by_schedule(order: WorkerConfig, shard: int, schedule: Deaths, ticks: int) -> bool:
    """Whether every cell of the shard is dead by the schedule after so many ticks."""
    dead = {cell for tick, cells in schedule.items() if tick <= ticks for cell in cells}
    return dead.issuperset(order.partition.cells(shard).tolist())
