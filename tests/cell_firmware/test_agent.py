"""The agent against a real host and member, over the transport inside one process."""

import asyncio
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from bus.errors import CoordinatorLostError, WaitInterrupted, WireError
from bus.lattice import Lattice
from bus.lockstep import Coordinator, Loss, Participant
from bus.partition import Partition
from bus.sensors import SensorSchema
from bus.transports.event_loop import TransportEventLoop
from bus.transports.memory import MemoryBus, MemoryEndpoint
from bus.wire.frames import Control, SenseFrame
from cell_firmware import agent
from cell_firmware.board import Board
from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs, PerCellAdapter
from cell_firmware.firmware import Cells, Firmware
from cell_firmware.program import NoParameters
from cell_firmware.protocols.heat_diffusion import HeatDiffusion, HeatDiffusionParameters
from cell_firmware.shard import Shard

HEAT = HeatDiffusion(
    HeatDiffusionParameters.model_validate(
        {"diffusion_number": 0.2, "initial": [{"cell": [1, 1], "speed_m_s": [1.0, -1.0]}]}
    )
)
RUN = "test"


class Grumpy(CellFirmware):
    """Adds up what it receives; the cells of row 1 give up in tick 3, those of column 9 never start."""

    message = np.dtype([("n", "<f8")])

    def init(self, cell: Cell) -> dict[str, Any]:
        return {"row": cell.row, "sum": cell.column + 0.5, "tick": 0}

    def step(self, state: dict[str, Any], inputs: CellInputs) -> tuple[dict[str, Any], CellOutputs]:
        if state["row"] == 1 and state["tick"] == 3:
            raise RuntimeError("had enough")
        received = [message["n"] for message in inputs.inbox.values() if message is not None]
        total = state["sum"] + 0.1 * sum(received)
        after = {"row": state["row"], "sum": total, "tick": state["tick"] + 1}
        outbox = {side: {"n": total} for side in inputs.inbox}
        return after, CellOutputs((total, -total), outbox)


@dataclass
class System:
    """A host in the test's thread, and one thread with an event loop per shard."""

    firmware: Firmware
    partition: Partition
    everything: Callable[..., Cells]
    form: Any = "packed"
    deaths: dict[int, list[int]] = field(default_factory=dict)
    inject: Callable[[Control], None] | None = None

    def __post_init__(self) -> None:
        self.bus = MemoryBus()
        self.endpoint = self.bus.endpoint()
        self.host = Coordinator(
            self.endpoint,
            self.partition,
            self.form,
            run=RUN,
            readings=SensorSchema(1),
            message=self.firmware.message,
        )
        count = self.partition.count
        self.endpoints: list[MemoryEndpoint] = [self.bus.endpoint() for _ in range(count)]
        self.ended: list[agent.ShardResult | BaseException | None] = [None] * count
        self.threads = [threading.Thread(target=self._cells, args=(s,)) for s in range(count)]
        self.losses: list[Loss] = []
        self.malformed: Counter[str] = Counter()
        self.tick = 0
        for thread in self.threads:
            thread.start()
        self.host.barrier(10.0)
        for tick, cells in self.deaths.items():
            self.host.mark_dead(cells, tick)

    def member(self, s: int) -> Participant:
        member = Participant(
            self.endpoints[s],
            self.partition,
            s,
            self.form,
            run=RUN,
            readings=SensorSchema(1),
            message=self.firmware.message,
        )
        for tick, cells in self.deaths.items():
            member.mark_dead(cells, tick)
        return member

    def _cells(self, s: int) -> None:
        member = self.member(s)
        shard = Shard(Board(self.firmware), self.everything(self.partition.lattice), self.partition, s)
        member.ready(10.0)
        try:
            with asyncio.Runner(loop_factory=partial(TransportEventLoop, self.endpoints[s])) as runner:
                self.ended[s] = runner.run(agent.run(shard, member, self.inject))
        except Exception as error:  # noqa: BLE001 - looked at by the test
            self.ended[s] = error
        self.malformed += member.counters.malformed
        member.close()

    def run(self, ticks: int) -> NDArray[np.float64]:
        presence = np.zeros((len(self.partition.lattice), 1), dtype=np.bool_)
        drives: list[NDArray[np.float64]] = []
        for _ in range(ticks):
            self.host.publish(SenseFrame(self.tick, presence, None))
            frame, losses = self.host.gather(self.tick)
            drives.append(frame.drive)
            self.losses += losses
            self.tick += 1
        return np.array(drives)

    def join(self) -> None:
        for thread in self.threads:
            thread.join(10.0)
            assert not thread.is_alive()

    def stop(self) -> None:
        self.host.stop("enough")
        self.join()


@pytest.fixture
def system(everything: Callable[..., Cells]) -> Iterator[Callable[..., System]]:
    made: list[System] = []

    def make(firmware: Firmware, partition: Partition, **more: Any) -> System:
        made.append(System(firmware, partition, everything, **more))
        return made[-1]

    yield make
    for one in made:
        one.stop()
        one.host.close()
        one.endpoint.close()
        for endpoint in one.endpoints:
            endpoint.close()


@pytest.mark.parametrize("form", ["packed", "per_cell"])
@pytest.mark.parametrize("shards", [1, 3, 9])
def test_agents_on_the_bus_give_the_same_bytes_as_one_shard_without_one(
    grid: Callable[..., Lattice],
    system: Callable[..., System],
    run: Callable[..., Any],
    shards: int,
    form: str,
):
    lattice = grid(3, 3)
    running = system(HEAT, Partition.even(lattice, shards), form=form)
    drives = running.run(20)
    assert drives.tobytes() == run(HEAT, Partition.even(lattice, 1), 20).drives.tobytes()
    running.stop()
    assert running.ended == [agent.ShardResult(20, "enough", (), stopped=True)] * shards
    assert running.losses == []


@pytest.mark.parametrize("form", ["packed", "per_cell"])
@pytest.mark.parametrize("shards", [1, 2, 6])
def test_failed_firmware_reaches_the_plant_with_cell_tick_and_traceback_and_the_rest_goes_on(
    grid: Callable[..., Lattice],
    system: Callable[..., System],
    run: Callable[..., Any],
    shards: int,
    form: str,
):
    """Row 1 fails in tick 3: with six shards whole shards do, with one shard a part of it."""
    lattice = grid(3, 2)
    firmware = PerCellAdapter(Grumpy(NoParameters()))
    running = system(firmware, Partition.even(lattice, shards), form=form)
    drives = running.run(8)
    assert drives.tobytes() == run(firmware, Partition.even(lattice, 1), 8).drives.tobytes()
    row = [lattice.index((1, 0)), lattice.index((1, 1))]
    assert [(loss.cell, loss.tick, loss.reason) for loss in running.losses] == [(i, 3, "failed") for i in row]
    for loss in running.losses:
        assert loss.detail.startswith("RuntimeError: had enough\nTraceback (most recent call last):\n")
        assert ', in step\n    raise RuntimeError("had enough")' in loss.detail
    assert (drives[3:, row] == 0).all()
    running.stop()
    failures = [f for ended in running.ended if isinstance(ended, agent.ShardResult) for f in ended.failures]
    assert sorted((f.cell, f.tick) for f in failures) == [((1, 0), 3), ((1, 1), 3)]


@pytest.mark.parametrize("form", ["packed", "per_cell"])
@pytest.mark.parametrize("shards", [1, 2, 3, 9])
def test_cells_that_die_by_schedule_are_silent_from_their_tick_on(
    grid: Callable[..., Lattice],
    system: Callable[..., System],
    run: Callable[..., Any],
    shards: int,
    form: str,
):
    lattice = grid(3, 3)
    running = system(HEAT, Partition.even(lattice, shards), form=form, deaths={4: [4], 7: [0, 8]})
    drives = running.run(15)
    names = {tick: [lattice.cells[i] for i in cells] for tick, cells in running.deaths.items()}
    assert drives.tobytes() == run(HEAT, Partition.even(lattice, 1), 15, dead=names).drives.tobytes()


def test_a_failure_in_the_last_tick_before_a_scheduled_death_is_still_reported(
    grid: Callable[..., Lattice], system: Callable[..., System]
):
    running = system(PerCellAdapter(Grumpy(NoParameters())), Partition.each(grid(2, 1)), deaths={4: [1]})
    running.run(6)
    assert [(loss.cell, loss.tick, loss.reason) for loss in running.losses] == [(1, 3, "failed")]


def test_a_long_traceback_keeps_its_end(grid: Callable[..., Lattice], system: Callable[..., System]):
    class Deep(CellFirmware):
        def init(self, cell: Cell) -> None:
            return None

        def step(self, state: None, inputs: CellInputs) -> tuple[None, CellOutputs]:
            return self.one(90)

        def one(self, depth: int) -> tuple[None, CellOutputs]:
            return self.two(depth)

        def two(self, depth: int) -> tuple[None, CellOutputs]:
            return self.one(depth // (depth > 0) - 1)

    running = system(PerCellAdapter(Deep(NoParameters())), Partition.each(grid(1, 1)))
    running.run(1)
    (loss,) = running.losses
    assert len(loss.detail) == 4096
    assert loss.detail.startswith("ZeroDivisionError: ")
    assert loss.detail.rstrip().splitlines()[-1].startswith("ZeroDivisionError: ")


def test_when_the_plant_goes_away_the_run_says_so(
    grid: Callable[..., Lattice], system: Callable[..., System]
):
    running = system(HEAT, Partition.even(grid(2, 2), 2))
    running.run(3)
    running.host.close()
    running.join()
    assert [type(ended) for ended in running.ended] == [CoordinatorLostError] * 2


def test_waking_the_endpoint_ends_a_run_without_a_stop_record(
    grid: Callable[..., Lattice], system: Callable[..., System]
):
    running = system(HEAT, Partition.even(grid(2, 2), 1))
    running.run(2)
    running.endpoints[0].wake()
    running.join()
    assert [type(ended) for ended in running.ended] == [WaitInterrupted]


@pytest.fixture
def silent(
    grid: Callable[..., Lattice], everything: Callable[..., Cells]
) -> Iterator[tuple[MemoryEndpoint, Shard, Participant]]:
    """A shard's endpoint, cells and participant, ready for a plant that sends nothing."""
    partition = Partition.even(grid(2, 2), 1)
    bus = MemoryBus()
    endpoint, ours = bus.endpoint(), bus.endpoint()
    schema = SensorSchema(1)
    Coordinator(endpoint, partition, "packed", run=RUN, readings=schema, message=HEAT.message)
    member = Participant(ours, partition, 0, "packed", run=RUN, readings=schema, message=HEAT.message)
    member.ready(10.0)
    yield ours, Shard(Board(HEAT), everything(partition.lattice), partition, 0), member
    member.close()
    ours.close()
    endpoint.close()


def test_while_the_plant_is_silent_other_tasks_run_and_the_agent_has_no_thread_of_its_own(
    silent: tuple[MemoryEndpoint, Shard, Participant],
):
    endpoint, shard, member = silent
    threads = threading.active_count()
    ticked: list[float] = []

    async def main() -> None:
        task = asyncio.create_task(agent.run(shard, member))
        for _ in range(3):
            await asyncio.sleep(0.002)
            ticked.append(threading.active_count())
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task

    with asyncio.Runner(loop_factory=partial(TransportEventLoop, endpoint)) as runner:
        runner.run(main())
    assert ticked == [threads] * 3


def test_a_callback_from_another_thread_ends_the_wait_and_not_the_run(
    silent: tuple[MemoryEndpoint, Shard, Participant],
):
    endpoint, shard, member = silent

    async def main() -> list[str]:
        loop, seen = asyncio.get_running_loop(), list[str]()
        task = asyncio.create_task(agent.run(shard, member))

        def callback(text: str) -> None:
            seen.append(text)
            if text == "2":
                task.cancel()

        for text in "012":
            timer = threading.Timer(0.02 * int(text), loop.call_soon_threadsafe, (callback, text))
            timer.start()
        with pytest.raises(asyncio.CancelledError):
            await task
        return seen

    with asyncio.Runner(loop_factory=partial(TransportEventLoop, endpoint)) as runner:
        assert runner.run(main()) == ["0", "1", "2"]


async def test_another_event_loop_is_refused(silent: tuple[MemoryEndpoint, Shard, Participant]):
    _, shard, member = silent
    with pytest.raises(TypeError, match="must be a TransportEventLoop"):
        await agent.run(shard, member)


@pytest.mark.parametrize("by_payload", [False, True])
def test_an_error_of_the_step_itself_fails_all_cells_of_the_shard(
    by_payload: bool, grid: Callable[..., Lattice], system: Callable[..., System]
):
    """Not firmware's failure but our own: a shard that was stepped already."""
    running: System
    original = Shard.step
    by_payloads = Shard.step_payload

    def step(self: Shard, tick: int, *arguments: Any, **named: Any) -> Any:
        return original(self, tick + (tick == 2), *arguments, **named)

    def step_payload(self: Shard, codec: Any, tick: int, payload: bytes) -> Any:
        if not by_payload:
            return None
        if tick == 2:
            raise AssertionError("this is a bug: a shard was given tick 3 after tick 1")
        return by_payloads(self, codec, tick, payload)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Shard, "step", step)
        patch.setattr(Shard, "step_payload", step_payload)
        running = system(HEAT, Partition.even(grid(1, 1), 1))
        running.run(2)
        presence = np.zeros((1, 1), dtype=np.bool_)
        running.host.publish(SenseFrame(2, presence, None))
        (loss,) = running.host.gather(2)[1]
        running.join()
    assert (loss.cell, loss.tick, loss.reason) == (0, 2, "failed")
    assert loss.detail.endswith("this is a bug: a shard was given tick 3 after tick 1\n")


def test_a_fault_that_can_not_be_read_is_counted_and_the_cells_go_on(
    grid: Callable[..., Lattice], system: Callable[..., System], run: Callable[..., Any]
):
    def refuse(control: Control) -> None:
        raise WireError("control", "fault", f"{control.detail}: is no fault")

    partition = Partition.even(grid(3, 3), 3)
    running = system(HEAT, partition, inject=refuse)
    running.host.control(Control("fault", 0, (), "nonsense"))
    assert running.run(5).tobytes() == run(HEAT, partition, 5).drives.tobytes()
    running.stop()
    assert running.ended == [agent.ShardResult(5, "enough", (), stopped=True)] * 3
    assert running.malformed == {"control: fault": 3}
