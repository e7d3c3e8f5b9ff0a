"""Ticks of which a participant takes the payload as it is, and those for which it must gather."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from bus.errors import WaitInterrupted
from bus.lockstep import Participant
from bus.lockstep.registers import decode_registers
from bus.partition import Partition
from bus.wire.frames import Control
from tests.bus.support import MESSAGE, FakeClock, Network, System, grid, payloads, settle


@pytest.fixture
def system() -> Iterator[System]:
    """Three shards of one cell; a run in the format that relays."""
    network = Network("memory")
    yield System(network, Partition.even(grid(1, 3), 3), "relayed", MESSAGE).start()
    network.close()


def gather(system: System, tick: int, shard: int) -> None:
    """A participant's tick by ``gather`` and ``publish``."""
    member = system.members[shard]
    assert member.gather(tick, 1.0) is not None
    member.publish_registers(tick, lambda: pytest.fail("nobody wants registers"))
    member.publish(system.drive(shard, tick), system.links(shard, tick))


def run_tick(system: System, tick: int, plain: bool) -> list[bool]:
    """A tick of all; returns which of the shards took a payload."""
    system.host.publish(system.sense(tick))
    took = [plain and take(system, member, tick, shard) for shard, member in enumerate(system.members)]
    for shard, done in enumerate(took):
        if not done:
            gather(system, tick, shard)
    drive, losses = system.host.gather(tick)
    assert not losses
    for shard in range(3):
        assert (drive.drive[shard] == system.drive(shard, tick).drive).all()
    return took


def take(system: System, member: Participant, tick: int, shard: int) -> bool:
    """A participant's tick from payload to payload."""
    payload = member.take_payload(tick)
    if payload is None:
        return False
    codec = member._form
    assert codec.decode_sense(0, payload)[0] == tick
    (answer,) = codec.drive_payloads(system.drive(shard, tick), system.links(shard, tick))
    member.answer(answer)
    return True


def test_ticks_are_plain_from_the_first_on_and_counted_as_others(system: System) -> None:
    for tick in range(6):  # the start record comes with the first senses
        assert run_tick(system, tick, plain=True) == [True] * 3
    run_tick(system, 6, plain=False)
    assert run_tick(system, 7, plain=True) == [True] * 3
    for member in system.members:
        counted = member.counters
        assert (counted.sent, counted.delivered, counted.late, counted.lost) == (
            8,
            9,
            0,
            0,
        )  # start, and 8 senses


def test_messages_arrive_from_plain_ticks_and_in_them(system: System) -> None:
    for tick, plain in enumerate([False, True, True, False, False]):
        run_tick(system, tick, plain=plain)
    system.host.publish(system.sense(5))
    for shard, member in enumerate(system.members):
        inputs = member.gather(5, 1.0)
        assert isinstance(inputs, tuple)
        assert inputs.links is not None
        sent = {(int(a), int(b)): k for k, (a, b) in enumerate(_ends(system, shard))}
        for k, end in enumerate(sent):
            source = system.links(end[0], 4)
            assert source is not None
            out = system.partition.outgoing(end[0])
            (row,) = [j for j in range(len(out)) if int(out.source_side[j]) == end[1]]
            assert bool(inputs.links.sent[k]) == bool(source.sent[row])
            if source.sent[row]:
                assert inputs.links.message[k] == source.message[row]


def _ends(system: System, shard: int) -> Iterator[tuple[int, int]]:
    incoming = system.partition.incoming(shard)
    return zip(incoming.source.tolist(), incoming.source_side.tolist(), strict=True)


def test_a_control_record_makes_the_tick_one_to_gather(system: System) -> None:
    run_tick(system, 0, plain=False)
    run_tick(system, 1, plain=True)
    system.host.control(Control("fault", 2, ((0, 1),), "{}"))
    assert run_tick(system, 2, plain=True)[1] is False
    member = system.members[1]
    assert [fault.kind for fault in member.drain_faults(2)] == ["fault"]
    assert run_tick(system, 3, plain=True) == [True] * 3


def test_an_observer_of_registers_makes_a_tick_one_to_gather_and_looking_for_one_does_not(
    memory: Network,
) -> None:
    clock = FakeClock()
    system = System(memory, Partition.even(grid(1, 3), 3), "relayed", MESSAGE, clock=clock).start()
    for tick in range(4):
        clock.now += 1.0
        assert run_tick(system, tick, plain=True) == [True] * 3
    watcher = memory.endpoint()
    watcher.subscribe("mdms/*/shard/1/registers")
    settle(system.members[1]._registers.publisher, watcher)
    assert run_tick(system, 4, plain=True) == [True] * 3
    clock.now += 1.0
    system.host.publish(system.sense(5))
    assert system.members[1].take_payload(5) is None
    assert take(system, system.members[0], 5, 0)


def test_registers_are_shown_on_request_although_no_tick_has_published_any(memory: Network) -> None:
    system = System(memory, Partition.even(grid(1, 3), 3), "relayed", MESSAGE, clock=FakeClock()).start()
    member = system.members[1]
    member.read_registers_by(lambda: (np.array([[0, 1]]), {"a": np.array([7])}))
    run_tick(system, 0, plain=True)
    watcher = memory.endpoint()
    watcher.subscribe("mdms/*/shard/1/registers")
    settle(member._registers.publisher, watcher)
    system.host.show_registers()
    system.host.publish(system.sense(1))
    assert member.take_payload(1) is not None
    (frame,) = [decode_registers(payload, 1) for payload in payloads(watcher.receive_all(0))]
    assert (frame.tick, frame.registers["a"].tolist()) == (0, [7])


def test_a_payload_that_is_handed_back_is_gathered(system: System) -> None:
    run_tick(system, 0, plain=False)
    system.host.publish(system.sense(1))
    member = system.members[0]
    payload = member.take_payload(1)
    assert payload is not None
    member.gather_again(b"nonsense")
    assert sum(member.counters.malformed.values()) == 1
    member.gather_again(payload)
    inputs = member.gather(1, 1.0)
    assert isinstance(inputs, tuple)
    assert inputs.sense.presence.tolist() == system.sense(1).presence[:1].tolist()


def test_ticks_are_plain_again_after_a_neighbour_has_died(system: System) -> None:
    for tick in range(3):
        run_tick(system, tick, plain=True)
    for member in (system.host, *system.members[:2]):
        member.mark_dead([2], 3)
    alive = system.members[:2]
    for tick, plain in ((3, False), (4, True), (5, True)):
        system.host.publish(system.sense(tick))
        for shard, member in enumerate(alive):
            assert take(system, member, tick, shard) == plain
            if not plain:
                gather(system, tick, shard)
        drive, losses = system.host.gather(tick)
        assert not losses
        assert drive.drive[2].tolist() == [0.0, 0.0]


def test_the_last_tick_of_a_cell_with_a_scheduled_death_is_not_plain(system: System) -> None:
    member = system.members[0]
    member.schedule_death([0], 3)
    assert run_tick(system, 0, plain=True) == [False, True, True]  # the schedule is looked at once
    assert run_tick(system, 1, plain=True)[0]
    assert not run_tick(system, 2, plain=True)[0]
    ended = member.gather(3, 1.0)
    assert isinstance(ended, Control)
    assert ended.kind == "stop"


def test_a_wakeup_ends_the_wait_for_a_payload(system: System) -> None:
    run_tick(system, 0, plain=False)
    system.member_endpoints[0].wake()
    with pytest.raises(WaitInterrupted):
        system.members[0].take_payload(1)
