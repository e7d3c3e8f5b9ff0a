"""What cells show of themselves: its payload, and who gets it."""

from __future__ import annotations

from typing import Any

import msgpack
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from bus.errors import WireError
from bus.lockstep.registers import (
    RegisterFrame,
    RegisterRequest,
    decode_registers,
    encodable,
    encode_registers,
    merge_frames,
    requested_at,
)
from bus.partition import Partition
from tests.bus.support import FakeClock, Network, System, grid, payloads, settle

CELLS = np.array([[0, 1], [2, 3]])
REGISTERS = {
    "serial.overruns": np.arange(8, dtype=np.uint16).reshape(2, 4),
    "speed_loop.integral_v": np.array([[0.5, -0.0], [1e300, 2.0]]),
    "firmware.awake": np.array([True, False]),
}


def test_registers_come_over_the_wire_as_they_are():
    frame = decode_registers(encode_registers(RegisterFrame(7, CELLS, encodable(REGISTERS))), 2)
    assert frame.tick == 7
    np.testing.assert_array_equal(frame.cells, CELLS)
    assert list(frame.registers) == list(REGISTERS)
    for name, array in REGISTERS.items():
        assert frame.registers[name].dtype == array.dtype
        assert frame.registers[name].tobytes() == array.tobytes()
        assert frame.registers[name].shape == array.shape


def test_only_numbers_and_booleans_of_some_width_are_shown():
    arrays: dict[str, NDArray[Any]] = {
        "objects": np.array([object(), None]),
        "wide": np.zeros((2, 65)),
        "empty": np.zeros((2, 0)),
        "complex": np.zeros(2, dtype=complex),
        "text": np.array(["a", "b"]),
        "big-endian": np.array([1, 2], dtype=">i4"),
    }
    assert {name: array.dtype.str for name, array in encodable(arrays).items()} == {"big-endian": "<i4"}


def edited(**changes: Any) -> bytes:
    fields = msgpack.unpackb(encode_registers(RegisterFrame(7, CELLS, encodable(REGISTERS))))
    return msgpack.packb({**fields, **changes})


@pytest.mark.parametrize(
    "payload",
    [
        edited(cells=b"1234567"),
        edited(cells=bytes(24)),
        edited(cells=None),
        edited(registers=[1]),
        edited(registers={f"r{i}": ["<f8", [], bytes(16)] for i in range(257)}),
        edited(registers={"a" * 257: ["<f8", [], bytes(16)]}),
        edited(registers={3: ["<f8", [], bytes(16)]}),
        edited(registers={"a": ["<f8", [], bytes(15)]}),
        edited(registers={"a": ["<f8", [2], bytes(16)]}),
        edited(registers={"a": ["<f8", [65], bytes(8 * 130)]}),
        edited(registers={"a": ["<f8", [16, 16], bytes(8 * 512)]}),
        edited(registers={"a": ["<f8", [0], b""]}),
        edited(registers={"a": ["<f8", [True], bytes(16)]}),
        edited(registers={"a": ["|O", [], bytes(16)]}),
        edited(registers={"a": [["<f8"], [], bytes(16)]}),
        edited(registers={"a": ["|b1", [], b"\x00\x02"]}),
        edited(registers={"a": ["<f8", []]}),
        edited(registers={"a": 4}),
        edited(v=1),
        edited(more=1),
        b"\xc1",
    ],
)
def test_anything_else_is_refused(payload: bytes):
    with pytest.raises(WireError, match="registers"):
        decode_registers(payload, 2)


@given(st.data())
def test_no_bytes_make_more_than_a_wire_error(data: st.DataObject):
    payload = bytearray(encode_registers(RegisterFrame(7, CELLS, encodable(REGISTERS))))
    for _ in range(data.draw(st.integers(1, 4))):
        payload[data.draw(st.integers(0, len(payload) - 1))] = data.draw(st.integers(0, 255))
    try:
        frame = decode_registers(bytes(payload), 2)
    except WireError:
        return
    assert all(len(array) == len(frame.cells) for array in frame.registers.values())


def pair(network: Network, *wanted: RegisterRequest, clock: FakeClock | None = None) -> System:
    """A host that wants to see registers, and two members that show them."""
    partition = Partition.even(grid(2, 2), 2)
    return System(network, partition, "packed", clock=clock, wanted=wanted).start()


def readings(system: System, shard: int, tick: int) -> tuple[NDArray[np.int64], dict[str, NDArray[Any]]]:
    lattice, cells = system.partition.lattice, system.partition.cells(shard)
    return np.stack((lattice.rows[cells], lattice.columns[cells]), axis=1), {"a": cells * 100 + tick}


def test_the_plant_has_the_registers_of_a_tick_when_it_has_its_drives(network: Network):
    system = pair(network, RegisterRequest(2))
    for tick in range(5):
        system.host.publish(system.sense(tick))
        for shard, member in enumerate(system.members):
            member.gather(tick)
            member.publish_registers(tick, lambda shard=shard, tick=tick: readings(system, shard, tick))
            member.publish(system.drive(shard, tick), None)
        system.host.gather(tick)
        shown = [(one.tick, one.registers["a"].tolist()) for one in system.host.drain_registers()]
        assert shown == ([(tick, [100 * cell + tick for cell in range(4)])] if tick % 2 == 0 else [])
    system.host.stop()


def test_registers_of_a_tick_that_the_plant_has_begun_and_not_gathered_are_accepted(memory: Network):
    system = pair(memory, RegisterRequest(1))
    for tick in range(2):
        system.host.publish(system.sense(tick))
        for shard, member in enumerate(system.members):
            member.gather(tick)
            member.publish_registers(tick, lambda shard=shard, tick=tick: readings(system, shard, tick))
            member.publish(system.drive(shard, tick), None)
        if tick == 0:
            system.host.gather(0)
            system.host.drain_registers()
    system.host._inbox.poll(0)  # as a plant does that ends between two ticks
    assert not system.host.counters.malformed
    assert system.host.drain_registers() == []
    system.host.gather(1)
    assert [one.tick for one in system.host.drain_registers()] == [1]


def test_what_is_wanted_in_a_tick_is_all_that_anybody_wants():
    some, other, everything = (
        RegisterRequest(2, frozenset("a")),
        RegisterRequest(3, frozenset("b")),
        RegisterRequest(4),
    )
    names = [requested_at((some, other, everything), tick) for tick in range(7)]
    assert [found and found.names for found in names] == [None, None, {"a"}, {"b"}, None, None, {"a", "b"}]
    assert [found is None for found in names] == [False, True, False, False, False, True, False]
    assert requested_at((), 0) is None


def test_unrequested_registers_are_not_sent_over_the_bus(memory: Network):
    system = pair(memory, RegisterRequest(1, frozenset({"a", "nobody's"})), clock=FakeClock())
    watcher = memory.endpoint()
    watcher.subscribe("mdms/*/shard/*/registers")
    cells, registers = readings(system, 1, 0)
    for tick in range(2):  # the first comes with all of them: somebody may be watching
        system.members[1].publish_registers(tick, lambda: (cells, {**registers, "b": np.zeros(2)}))
    frames = [decode_registers(payload, 4) for payload in payloads(watcher.receive_all(0))]
    assert [sorted(frame.registers) for frame in frames] == [["a", "b"], ["a"]]


def test_frames_of_a_tick_are_joined_in_the_order_of_the_cells():
    lattice = grid(2, 2)
    first = RegisterFrame(5, np.array([[1, 1], [0, 0]]), {"a": np.array([3, 0]), "f": np.array([0.5, 0.25])})
    second = RegisterFrame(5, np.array([[1, 0]]), {"a": np.array([2.5]), "f": np.array([[1.0, 2.0]])})
    (shown_,) = merge_frames([first, second], lattice)
    assert shown_.tick == 5
    assert shown_.cells.tolist() == [True, False, True, True]
    assert shown_.registers["a"].tolist() == [0.0, 0.0, 2.5, 3.0]  # of two types, the one that holds both
    np.testing.assert_array_equal(
        shown_.registers["f"], [0.25, 0.0, np.nan, 0.5]
    )  # of another shape: no number
    assert [one.tick for one in merge_frames([first, second._replace(tick=6)], lattice)] == [5, 6]


def test_where_nobody_wants_to_see_registers_they_are_not_even_read(network: Network):
    system = pair(network)

    def read() -> Any:
        raise AssertionError("nobody wants to see this")

    system.members[0].publish_registers(0, read)
    assert system.host.drain_registers() == []


def test_who_watches_a_run_is_shown_its_cells_five_times_a_second(memory: Network):
    clock = FakeClock()
    system = pair(memory, clock=clock)
    watcher = memory.endpoint()
    watcher.subscribe("mdms/*/shard/*/registers")
    member = system.members[1]
    settle(member._registers.publisher, watcher)
    for tick in range(100):
        clock.now += 0.01
        member.publish_registers(tick, lambda tick=tick: readings(system, 1, tick))
    frames = [decode_registers(payload, 4) for payload in payloads(watcher.receive_all(0))]
    assert len(frames) in (5, 6)
    assert {tuple(cell) for frame in frames for cell in frame.cells.tolist()} == {(1, 0), (1, 1)}


def test_registers_of_cells_that_are_not_the_shards_are_refused(memory: Network):
    system = pair(memory, RegisterRequest(1))
    system.host.publish(system.sense(0))
    wrong = readings(system, 1, 0)
    for shard, member in enumerate(system.members):
        member.gather(0)
        member.publish_registers(0, lambda: wrong)
        member.publish(system.drive(shard, 0), None)
    system.host.gather(0)
    (shown_,) = system.host.drain_registers()
    assert shown_.cells.tolist() == [False, False, True, True]
    assert system.host.counters.malformed["registers: cells"] == 1
