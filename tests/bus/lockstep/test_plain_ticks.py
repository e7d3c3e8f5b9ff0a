"""Ticks of which a participant takes the payload as it is, and those for which it must gather."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from bus.errors import WaitInterrupted
from bus.lockstep import Participant
from bus.lockstep.registers import decode_registers
from bus.partition import Partition
from bus.spec import NO_LATENCY, BusSpec
from bus.wire.formats import WireFormat
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


@pytest.fixture
def direct() -> Iterator[System]:
    """Three shards of one cell over Zenoh, whose steps return soon."""
    network = Network("zenoh")
    yield System(network, Partition.even(grid(1, 3), 3), "relayed", MESSAGE, direct=True).start()
    network.close()


def test_plain_ticks_are_answered_in_a_thread_of_the_transport(direct: System) -> None:
    """Until a control record comes, before the payload of its tick."""
    run_tick(direct, 0, plain=True)
    member, threads, ticks = direct.members[0], set[int](), list[int]()
    codec = member._form

    def step(tick: int, payload: bytes) -> bytes:
        threads.add(threading.get_ident())
        ticks.append(tick)
        assert codec.decode_sense(0, payload)[0] == tick
        return codec.drive_payloads(direct.drive(0, tick), direct.links(0, tick))[0]

    reader = threading.Thread(target=_answer, args=(member, step, lambda: ticks[-1:] == [5]))
    reader.start()
    for tick in range(1, 7):
        if tick == 6:
            direct.host.control(Control("fault", 6, ((0, 0),), "{}"))
        direct.host.publish(direct.sense(tick))
        for shard in (1, 2):
            gather(direct, tick, shard)
        if tick == 6:
            reader.join(5.0)
            assert not reader.is_alive()
            gather(direct, 6, 0)
        drive, losses = direct.host.gather(tick)
        assert not losses
        assert (drive.drive[0] == direct.drive(0, tick).drive).all()
    assert [fault.kind for fault in member.drain_faults(6)] == ["fault"]
    assert ticks == [1, 2, 3, 4, 5]
    assert threads
    assert not threads & {reader.ident, threading.get_ident()}
    assert (member.counters.sent, member.counters.lost) == (7, 0)


def test_a_step_that_leaves_its_payload_has_it_gathered(direct: System) -> None:
    run_tick(direct, 0, plain=True)
    asked = list[int]()

    def step(tick: int, payload: bytes) -> None:
        asked.append(tick)

    reader = threading.Thread(target=_answer, args=(direct.members[0], step, lambda: bool(asked)))
    reader.start()
    direct.host.publish(direct.sense(1))
    reader.join(5.0)
    assert not reader.is_alive()
    for shard in range(3):
        gather(direct, 1, shard)
    assert (direct.host.gather(1)[0].drive[0] == direct.drive(0, 1).drive).all()


def _answer(
    member: Participant, step: Callable[[int, bytes], bytes | None], is_over: Callable[[], bool]
) -> None:
    """Have plain ticks answered until it is over; a payload that comes between two calls is answered here."""
    tick = 1
    while not is_over():
        member.answer_directly(tick, step)
        tick = member._tick
        if not is_over() and (payload := member.take_payload(tick)) is not None:
            drives = step(tick, payload)
            if drives is None:
                member.gather_again(payload)
                return
            member.answer(drives)
            tick += 1


def answered_from_2(system: System, between: Callable[[], None]) -> list[int]:
    """Run two ticks, have those from 2 on answered directly, and return these; ``between`` comes before tick 3."""
    for tick, plain in ((0, False), (1, True)):
        run_tick(system, tick, plain=plain)
    member, ticks = system.members[0], list[int]()
    codec = member._form

    def step(tick: int, payload: bytes) -> bytes:
        ticks.append(tick)
        return codec.drive_payloads(system.drive(0, tick), system.links(0, tick))[0]

    reader = threading.Thread(target=member.answer_directly, args=(2, step), daemon=True)
    reader.start()
    for tick in (2, 3):
        if tick == 3:
            between()
        system.host.publish(system.sense(tick))
        for shard in (1, 2):
            gather(system, tick, shard)
        if tick == 2:
            system.host.gather(2)
    reader.join(1.0)
    return ticks if not reader.is_alive() else [*ticks, -1]


def test_the_last_tick_before_a_scheduled_death_is_not_answered_directly(memory: Network) -> None:
    system = System(memory, Partition.even(grid(1, 3), 3), "relayed", MESSAGE, direct=True).start()
    system.members[0].schedule_death([0], 4)
    assert answered_from_2(system, lambda: None) == [2]


def test_no_tick_is_answered_directly_once_observers_are_to_be_looked_for(memory: Network) -> None:
    system = System(memory, Partition.even(grid(1, 3), 3), "relayed", MESSAGE, direct=True).start()
    registers = system.members[0]._registers
    assert answered_from_2(system, lambda: setattr(registers, "next_look", 0.0)) == [2]


def is_direct(cells: Partition, form: WireFormat, latency: BusSpec = NO_LATENCY, direct: bool = True) -> bool:
    system = System(Network("memory"), cells, form, MESSAGE, latency=latency, direct=direct)
    return system.members[0].is_direct


def test_answers_are_not_given_in_the_transport_where_they_might_wait_there() -> None:
    """Payloads that come before the last answer has left, and answers too large for the transport's memory."""
    cells = Partition.even(grid(1, 3), 3)
    assert is_direct(cells, "relayed")
    assert not is_direct(cells, "relayed", direct=False)
    assert not is_direct(cells, "packed")  # messages come in payloads of their own
    assert not is_direct(cells, "relayed", BusSpec(link_ticks=3, sense_to_drive_ticks=2))
    for side, small in ((40, True), (50, False)):  # 16 bytes a cell
        assert is_direct(Partition.even(grid(side, side), 1), "packed") == small
