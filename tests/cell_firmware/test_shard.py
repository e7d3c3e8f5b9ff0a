from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from bus.lattice import SIDES, Lattice
from bus.partition import Partition
from cell_firmware.board import Board
from cell_firmware.build import MotorFacts
from cell_firmware.cell import Cell, CellFirmware, CellInputs, CellOutputs, PerCellAdapter
from cell_firmware.effects.base import ShardContext
from cell_firmware.effects.clock.spec import ClockSpec
from cell_firmware.effects.link_delay import LinkDelaySpec
from cell_firmware.effects.link_loss import LinkLossSpec
from cell_firmware.effects.registry import CellEffects
from cell_firmware.effects.sensor import SensorSpec
from cell_firmware.errors import FirmwareError
from cell_firmware.firmware import Cells, Firmware, Inputs, Outbox, Outputs, State
from cell_firmware.program import NoParameters
from cell_firmware.shard import Shard


class Gossip(Firmware):
    """Mixes everything a cell may know into its speed, and sends on some sides in some ticks only."""

    message = np.dtype([("u", "<f8"), ("n", "<u2")])

    def init(self, cells: Cells) -> State:
        return {"u": cells.position_m[:, 0] + 0.1 * cells.position_m[:, 1], "n": cells.row + 3 * cells.column}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        assert inputs.inbox is not None
        u, n = state["u"], state["n"]
        received, message = inputs.inbox.received, inputs.inbox.message
        for side in range(4):
            u = u + np.where(received[:, side], message["u"][:, side] / (3.0 + side), 0.01)
            n = n + message["n"][:, side]
        u = np.sqrt(u * u + 0.5) - 0.3 * inputs.presence[:, 0]
        n = n % 1000
        sent = (n[:, None] + np.arange(4)) % 3 != 0
        out = np.empty((len(u), 4), dtype=self.message)
        out["u"], out["n"] = u[:, None] * (1.0 + np.arange(4)), n[:, None]
        return {"u": u, "n": n}, Outputs(np.stack((u, -u * u), axis=1) / 100, Outbox(sent, out))


class PlainGossip(CellFirmware):
    """Passes on the largest number received, as plain values."""

    message = np.dtype([("n", "<i4"), ("ok", "?")])

    def init(self, cell: Cell) -> list[Any]:
        return [cell.row * 10 + cell.column, cell.neighbours]

    def step(self, state: list[Any], inputs: CellInputs) -> tuple[list[Any], CellOutputs]:
        received = [
            message["n"] for message in inputs.inbox.values() if message is not None and message["ok"]
        ]
        largest = max([state[0], *received])
        outbox = {side: {"n": largest, "ok": inputs.presence[0]} for side in state[1]}
        return [largest, state[1]], CellOutputs((largest / 100, 0.0), outbox)


FIRMWARE = {"arrays": Gossip(NoParameters()), "plain": PerCellAdapter(PlainGossip(NoParameters()))}

EFFECTS = {
    "none": CellEffects(),
    "ordered": CellEffects(
        sensor=SensorSpec(false_positive=0.2, false_negative=0.3, latency_ticks=1),
        link_loss=LinkLossSpec(probability=0.3),
        link_delay=LinkDelaySpec(between_ticks=(0, 2)),
    ),
    "slow": CellEffects(link_delay=LinkDelaySpec(ticks=2)),
    "overtaking": CellEffects(link_delay=LinkDelaySpec(between_ticks=(0, 3), ordered=False)),
}

places = st.sets(st.tuples(st.integers(0, 4), st.integers(0, 4)), min_size=1, max_size=14)


def cut(lattice: Lattice, labels: list[int]) -> Partition:
    """The cells with the same label, whatever their place, make a shard."""
    names = sorted({labels[i] for i in range(len(lattice))})
    return Partition(lattice, [[i for i in range(len(lattice)) if labels[i] == name] for name in names])


@pytest.mark.parametrize("kind", FIRMWARE)
@pytest.mark.parametrize(
    ("motors", "effects", "clock"),
    [
        (False, "none", None),
        (True, "none", None),
        (False, "ordered", None),
        (False, "slow", None),
        (False, "overtaking", None),
        (True, "none", ClockSpec(error_ppm=60_000)),
        (False, "overtaking", ClockSpec(error_ppm=20_000, exchanges_per_period=2)),
    ],
)
@settings(max_examples=25)
@given(data=st.data())
def test_any_partition_of_any_array_gives_the_same_bytes_as_one_shard(
    run: Callable[..., Any],
    kind: str,
    motors: bool,
    effects: str,
    clock: ClockSpec | None,
    data: st.DataObject,
):
    """Irregular arrays, scattered shards, silent sides, cells dying on the way, chance, clocks that differ."""
    lattice = Lattice(data.draw(places))
    n, ticks = len(lattice), 8
    labels = data.draw(st.lists(st.integers(0, 3), min_size=n, max_size=n))
    deaths = data.draw(
        st.dictionaries(st.integers(0, 6), st.lists(st.sampled_from(lattice.cells)), max_size=3)
    )
    random = np.random.default_rng(data.draw(st.integers(0, 99)))
    inputs: dict[str, Any] = {
        "presence": random.random((ticks, n, 1)) < 0.7,
        "encoder_m": np.cumsum(random.random((ticks, n, 2)) * 1e-4, axis=0) if motors else None,
        "dead": deaths,
        "motors": MotorFacts(12.0, 1.2) if motors else None,
        "effects": EFFECTS[effects],
        "seed": data.draw(st.integers(0, 2**63 - 1)),
        "clocks": clock and clock.clocks(lattice, 4_096_000, data.draw(st.integers(0, 99))),
    }
    whole = run(FIRMWARE[kind], Partition.even(lattice, 1), ticks, **inputs)
    parts = run(FIRMWARE[kind], cut(lattice, labels), ticks, **inputs)
    each = run(FIRMWARE[kind], Partition.each(lattice), ticks, **inputs)
    assert not whole.failures
    assert parts.drives.tobytes() == whole.drives.tobytes() == each.drives.tobytes()
    assert parts.counted == whole.counted == each.counted


class Echo(Firmware):
    """Drives ``sum of 10^side x (index of who sent on it)`` and sends its own index on every side."""

    message = np.dtype([("who", "<i8")])

    def init(self, cells: Cells) -> State:
        return {"me": cells.row * 3 + cells.column}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        assert inputs.inbox is not None
        received = np.where(inputs.inbox.received, inputs.inbox.message["who"], 0)
        speed = np.zeros((len(received), 2))
        for side in range(4):
            speed[:, 0] += received[:, side] * 10.0**side
        speed[:, 1] = inputs.inbox.received @ np.array([1, 2, 4, 8])
        message = np.empty((len(received), 4), dtype=self.message)
        message["who"] = state["me"][:, None]
        return state, Outputs(speed, Outbox(np.ones((len(received), 4), dtype=np.bool_), message))


@pytest.mark.parametrize("shards", [1, 2, 9])
def test_a_message_sent_in_one_tick_is_read_in_the_next_on_the_side_that_faces_the_sender(
    grid: Callable[..., Lattice], run: Callable[..., Any], shards: int
):
    lattice = grid(3, 3)
    drives = run(Echo(NoParameters()), Partition.even(lattice, shards), 2).drives
    np.testing.assert_array_equal(drives[0], 0.0)
    centre = lattice.index((1, 1))
    # north is cell 2,1 (7), east 1,2 (5), south 0,1 (1), west 1,0 (3)
    assert drives[1, centre].tolist() == [7 + 50 + 100 + 3000, 15]
    corner = lattice.index((0, 0))
    assert drives[1, corner].tolist() == [3 + 10, 1 + 2]
    assert SIDES == ("north", "east", "south", "west")


@pytest.mark.parametrize("shards", [1, 3, 9])
def test_a_retired_cell_neither_drives_nor_sends_and_its_last_message_still_arrives(
    grid: Callable[..., Lattice], run: Callable[..., Any], shards: int
):
    lattice = grid(3, 3)
    drives = run(Echo(NoParameters()), Partition.even(lattice, shards), 6, dead={3: [(1, 1)]}).drives
    north = lattice.index((2, 1))
    assert drives[3:, lattice.index((1, 1))].tolist() == [[0.0, 0.0]] * 3
    assert drives[2, lattice.index((1, 1)), 0] != 0
    assert drives[:, north, 1].tolist() == [0, 14, 14, 14, 10, 10]


def test_a_shard_whose_cells_are_all_gone_still_answers_with_zeros(
    grid: Callable[..., Lattice], run: Callable[..., Any]
):
    lattice = grid(2, 2)
    drives = run(Echo(NoParameters()), Partition.even(lattice, 2), 3, dead={1: list(lattice.cells)}).drives
    np.testing.assert_array_equal(drives[1:], 0.0)


def shard_of(firmware: Firmware, cells: Cells, lattice: Lattice) -> Shard:
    return Shard(Board(firmware), cells, Partition.each(lattice), 0)


def test_messages_leave_in_the_partitions_order_and_read_zero_where_nothing_was_sent(
    grid: Callable[..., Lattice], everything: Callable[..., Cells]
):
    lattice = grid(3, 3)
    partition = Partition(lattice, [[4], [0, 1, 2, 3, 5, 6, 7, 8]])
    outgoing = partition.outgoing(1)
    shard = Shard(Board(Echo(NoParameters())), everything(lattice), partition, 1)
    shard.retire([(0, 1)])
    links = shard.step(0, np.zeros((8, 1), dtype=np.bool_)).links
    assert links is not None
    assert outgoing.source.tolist() == [1, 3, 5, 7]
    assert links.sent.tolist() == [False, True, True, True]
    assert links.message["who"].tolist() == [0, 3, 5, 7]


def test_ticks_must_follow_each_other(grid: Callable[..., Lattice], everything: Callable[..., Cells]):
    lattice = grid(2, 2)
    shard = shard_of(Echo(NoParameters()), everything(lattice), lattice)
    bits: NDArray[np.bool_] = np.zeros((1, 1), dtype=np.bool_)
    shard.step(0, bits)
    with pytest.raises(FirmwareError, match="this is a bug: a shard was given tick 2 after tick 0"):
        shard.step(2, bits)


class Looking(Firmware):
    """Keeps what it is given."""

    def init(self, cells: Cells) -> State:
        return {"here": cells.row}

    def step(self, state: State, inputs: Inputs) -> tuple[State, Outputs]:
        self.seen = inputs
        return state, Outputs(np.zeros((len(inputs.presence), 2)))


def test_without_effects_nothing_stands_between_the_senses_and_the_firmware(
    grid: Callable[..., Lattice], everything: Callable[..., Cells]
):
    lattice = grid(1, 2)
    assert CellEffects().input_filters(ShardContext(np.arange(2), 1, Echo.message, 0)) == {}
    for effects in (None, EFFECTS["ordered"].input_filters(ShardContext(np.arange(2), 1, None, 0))):
        firmware, presence = Looking(NoParameters()), np.ones((2, 1), dtype=np.bool_)
        shard = Shard(Board(firmware), everything(lattice), Partition.even(lattice, 1), 0, effects)
        shard.step(0, presence)
        assert (firmware.seen.presence is presence) == (effects is None)


def test_registers_show_the_messages_of_live_cells_by_side() -> None:
    lattice = Lattice((row, column) for row in range(2) for column in range(3))
    position_m = np.stack((0.1 * lattice.columns, 0.1 * lattice.rows), axis=1)
    cells = Cells.of(lattice, position_m, 0.004)
    shard = Shard(Board(Gossip(NoParameters())), cells, Partition.even(lattice, 1), 0)
    shard.step(0, np.zeros((6, 1), dtype=np.bool_))
    assert not any(name.startswith("message.") for name in shard.registers()[1])
    shard.shows_messages = True
    shard.retire([(0, 1)])
    shard.step(1, np.zeros((6, 1), dtype=np.bool_))
    places, registers = shard.registers()
    assert places.tolist() == [[0, 0], [0, 2], [1, 0], [1, 1], [1, 2]]
    u, n = registers["firmware.u"], registers["firmware.n"]
    sent = registers["message.sent"]
    np.testing.assert_array_equal(sent, (n[:, None] + np.arange(4)) % 3 != 0)
    assert sent.any()
    np.testing.assert_array_equal(registers["message.u"][sent], (u[:, None] * (1.0 + np.arange(4)))[sent])
