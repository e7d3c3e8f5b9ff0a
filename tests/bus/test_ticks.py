"""Ticks of host and members: who gets what, early, late and out of shape."""

from __future__ import annotations

import threading

import numpy as np
import pytest

from bus.errors import BusError, RunNameError
from bus.lockstep import Coordinator, MessageCounters, Participant, TickInputs
from bus.partition import Partition
from bus.sensors import CameraFrame, SensorSchema
from bus.spec import NO_LATENCY, BusSpec
from bus.wire.formats import WireFormat
from bus.wire.frames import Control, DriveFrame, LinkFrame
from bus.wire.keys import shard_key
from tests.bus.support import (
    EVERYTHING,
    MESSAGE,
    SENSORS,
    Network,
    System,
    every_format,
    expected_drive,
    gathered,
    grid,
    step,
)


@every_format
@pytest.mark.parametrize("count", [1, 2, 6])
def test_members_get_the_senses_of_their_cells_and_the_host_their_drives(
    network: Network, form: WireFormat, count: int
) -> None:
    system = System(network, Partition.even(grid(2, 3), count), form, readings=EVERYTHING).start()
    for tick in range(3):
        sense = system.sense(tick)
        system.host.publish(sense)
        for shard, member in enumerate(system.members):
            mine, links = gathered(member.gather(tick))
            cells = system.partition.cells(shard)
            assert links is None
            assert mine.tick == tick
            assert mine.presence.tolist() == sense.presence[cells].tolist()
            assert mine.encoder_m is not None
            assert sense.encoder_m is not None
            assert mine.encoder_m.tolist() == sense.encoder_m[cells].tolist()
            assert mine.level is not None
            assert sense.level is not None
            assert mine.level.tolist() == sense.level[cells].tolist()
            assert mine.label is not None
            assert sense.label is not None
            assert mine.label.tolist() == sense.label[cells].tolist()
            assert (mine.picture is None) == (sense.picture is None) == (tick != 0)
            if mine.picture is not None and sense.picture is not None:
                assert mine.picture.parcel.tolist() == sense.picture.parcel.tolist() == [1, 2]
                assert mine.picture.pose.tobytes() == sense.picture.pose.tobytes()
            member.publish(system.drive(shard, tick), None)
        drive, losses = system.host.gather(tick)
        assert drive.tick == tick
        assert drive.drive.tolist() == expected_drive(system, tick).tolist()
        assert losses == []


@every_format
@pytest.mark.parametrize("count", [1, 2, 6])
def test_messages_of_a_tick_are_read_in_the_next(network: Network, form: WireFormat, count: int) -> None:
    system = System(network, Partition.even(grid(2, 3), count), form, message=MESSAGE).start()
    partition = system.partition
    for tick in range(4):
        system.host.publish(system.sense(tick))
        for shard, member in enumerate(system.members):
            _, links = gathered(member.gather(tick))
            incoming = partition.incoming(shard)
            assert links is not None
            assert links.tick == tick - 1
            sent = (incoming.source + incoming.source_side + tick - 1) % 3 != 0
            if tick == 0:
                sent[:] = False
            assert links.sent.tolist() == sent.tolist()
            said = (incoming.source * 4 + incoming.source_side) / 3.0 + (tick - 1)
            assert links.message["u"].tolist() == np.where(sent, said, 0.0).tolist()
            assert links.message["hops"].tolist() == np.where(sent, incoming.source + tick - 1, 0).tolist()
            member.publish(system.drive(shard, tick), system.links(shard, tick))
        assert system.host.gather(tick)[1] == []


def test_all_sides_counts_come_together_when_the_run_stops(network: Network) -> None:
    system = System(network, Partition.even(grid(2, 3), 2), "packed", message=MESSAGE).start()
    for tick in range(5):
        step(system, tick)
    stopped: list[TickInputs | Control] = []

    def leave(member: Participant) -> None:
        stopped.append(member.gather(5))
        member.close()

    threads = [threading.Thread(target=leave, args=(member,)) for member in system.members]
    for thread in threads:
        thread.start()
    total = system.host.stop("done", 5.0)
    for thread in threads:
        thread.join()
    assert [(record.kind, record.detail) for record in stopped if isinstance(record, Control)] == [
        ("stop", "done")
    ] * 2
    # Senses, start and stop from the plant; a drive and a link frame a tick from each shard.
    assert system.host.counters.sent == 5 * 2 + 2 * 2
    assert total.sent == 5 * 2 + 2 * 2 + 5 * 2 * 2
    assert total.delivered == total.sent
    assert (total.lost, total.late, sum(total.malformed.values())) == (0, 0, 0)
    assert total.cell_counters == {"shards": 2, "numbers": 1, "nothing": 0}
    assert system.host.unreported == []


def test_a_member_stays_until_the_plant_has_taken_its_counts(network: Network) -> None:
    system = System(network, Partition.each(grid(1, 1)), "packed").start()
    system.host.control(Control("stop", 0))
    assert isinstance(system.members[0].gather(0), Control)
    leaves = threading.Thread(target=system.members[0].close)
    leaves.start()
    leaves.join(0.2)
    assert leaves.is_alive()
    assert system.host.stop("again", 5.0).cell_counters["shards"] == 1
    leaves.join(5.0)
    assert not leaves.is_alive()


@pytest.mark.parametrize("reports", [True, False])
def test_a_report_may_come_after_the_token_has_gone(memory: Network, reports: bool) -> None:
    system = System(memory, Partition.even(grid(2, 3), 2), "packed", message=MESSAGE).start()
    step(system, 0)
    system.members[0].close()
    system.member_endpoints[1].withdraw(shard_key("test", 1, "ready"))
    system.member_endpoints[1].withdraw(shard_key("test", 1, "alive"))
    late = threading.Timer(0.1, system.members[1].close) if reports else threading.Timer(0.1, int)
    late.start()
    total = system.host.stop("done", 1.0)
    late.join()
    assert total.cell_counters["shards"] == (2 if reports else 1)
    assert system.host.unreported == ([] if reports else [3, 4, 5])


@pytest.mark.parametrize("form", ["packed", "per_cell"])
def test_an_early_frame_is_stored_until_its_tick(memory: Network, form: WireFormat) -> None:
    system = System(memory, Partition.each(grid(1, 2)), form, message=MESSAGE).start()
    one, other = system.members
    for tick in range(2):
        system.host.publish(system.sense(tick))
    for tick in range(2):
        gathered(one.gather(tick)) if tick == 0 else None
        one.publish(system.drive(0, tick), system.links(0, tick))
    for tick in range(2):
        _, links = gathered(other.gather(tick))
        assert links is not None
        assert links.tick == tick - 1
        other.publish(system.drive(1, tick), system.links(1, tick))
    for tick in range(2):
        drive, _ = system.host.gather(tick)
        assert drive.drive.tolist() == expected_drive(system, tick).tolist()
    assert system.host.counters.late == 0


def test_senses_that_bring_messages_follow_the_drives_that_brought_them(memory: Network) -> None:
    system = System(memory, Partition.each(grid(1, 2)), "relayed", message=MESSAGE).start()
    system.host.publish(system.sense(0))
    with pytest.raises(BusError, match=r"tick 1: brings the messages of tick 0, .* gathered is -1"):
        system.host.publish(system.sense(1))


def test_a_message_that_comes_after_the_senses_ends_the_wait_for_it(network: Network) -> None:
    system = System(network, Partition.each(grid(1, 2)), "per_cell", message=MESSAGE).start()
    one, other = system.members
    step(system, 0)
    system.host.publish(system.sense(1))
    links = system.links(0, 1)
    gathered(one.gather(1))
    gathered(other.gather(1))
    other.publish(system.drive(1, 1), system.links(1, 1))
    system.host.publish(system.sense(2))
    later = threading.Timer(0.2, lambda: one.publish(system.drive(0, 1), links))
    later.start()
    _, received = gathered(other.gather(2))  # the senses are there, the neighbour's message comes
    later.join()
    assert links is not None
    assert received is not None
    assert (received.tick, received.message.tolist()) == (1, links.message.tolist())


@every_format
@pytest.mark.parametrize(
    "latency", [NO_LATENCY, BusSpec(link_ticks=3), BusSpec(sense_to_drive_ticks=2, link_ticks=4)]
)
def test_a_resumed_run_reads_the_messages_that_were_under_way(
    network: Network, form: WireFormat, latency: BusSpec
) -> None:
    partition = Partition.each(grid(1, 3))
    whole = System(network, partition, form, message=MESSAGE, latency=latency, keeps=True).start()
    expected: dict[int, list[object]] = {}
    together = None
    for tick in range(12):
        if tick == 6:
            whole.host.request_snapshot(7)
        if tick == 7:
            whole.host.record_snapshot()
        expected[tick] = _heard(whole, tick)
        together = whole.host.poll_snapshot() or together
    assert together is not None
    other = Network("memory")
    again = System(other, partition, form, message=MESSAGE, latency=latency)
    again.host.resume(7, [], MessageCounters(), together.relayed)
    for shard, member in enumerate(again.members):
        member.resume(7, [], together.links[shard])
        member.ready(10.0)
    again.host.barrier(10.0)
    for tick in range(7, 12):
        assert _heard(again, tick) == expected[tick]
    if network.name == "memory":  # of the last tick's messages, over Zenoh some come later
        sides = [side.counters for side in (*whole.members, whole.host)]
        resumed = [side.counters for side in (*again.members, again.host)]
        total, same = sum(resumed, together.counts), sum(sides, MessageCounters())
        assert (total.sent, total.delivered, total.lost, total.late) == (same.sent, same.delivered, 0, 0)


def _heard(system: System, tick: int) -> list[object]:
    """Run a tick, drives gathered at once; return what each shard read."""
    heard: list[object] = []
    system.host.publish(system.sense(tick))
    for shard, member in enumerate(system.members):
        links = gathered(member.gather(tick)).links
        assert links is not None
        heard.append((links.tick, links.sent.tolist(), links.message.tolist()))
        member.publish(system.drive(shard, tick), system.links(shard, tick))
        member.publish_snapshot(tick + 1, lambda: b"state")
    assert system.host.gather(tick)[1] == []
    return heard


@every_format
def test_a_frame_of_a_tick_that_is_over_is_counted_as_late(memory: Network, form: WireFormat) -> None:
    system = System(memory, Partition.each(grid(1, 1)), form).start()
    step(system, 0)
    system.members[0].publish(system.drive(0, 0), None)
    step(system, 1)
    assert system.host.counters.late == 1


def test_publishing_another_shape_than_agreed_is_refused_with_its_place(memory: Network) -> None:
    system = System(memory, Partition.each(grid(1, 2)), "packed", message=MESSAGE).start()
    member, links = system.members[1], system.links(1, 0)
    with pytest.raises(BusError, match=r"drive of shard 1, tick 0: must be float64 \(1, 2\)"):
        member.publish(DriveFrame(0, np.zeros((2, 2))), links)
    with pytest.raises(BusError, match=r"drive of cell 0,1, tick 0: must be finite, is \[nan, 0.0\]"):
        member.publish(DriveFrame(0, np.array([[np.nan, 0.0]])), links)
    with pytest.raises(BusError, match="the firmware has messages"):
        member.publish(system.drive(1, 0), None)
    with pytest.raises(BusError, match="links of shard 1, tick 0: must be 1 of"):
        member.publish(system.drive(1, 0), LinkFrame(0, np.zeros(2, np.bool_), np.zeros(2, MESSAGE)))
    with pytest.raises(BusError, match=r"sense frame of tick 0: must have \{'presence': "):
        system.host.publish(System.sense(system, 0).__class__(0, np.zeros((3, SENSORS), np.bool_), None))
    level = np.zeros((2, SENSORS))
    with pytest.raises(BusError, match=r"must have {'presence': \(2, 2\)}, has .* 'levels': \(2, 2\)}"):
        system.host.publish(system.sense(0)._replace(level=level))
    with pytest.raises(BusError, match="'labels'"):
        system.host.publish(system.sense(0)._replace(label=np.zeros(2, np.int64)))
    nobody = CameraFrame(np.zeros(0, np.int64), np.zeros((0, 3)))
    with pytest.raises(BusError, match="'a picture'"):
        system.host.publish(system.sense(0)._replace(picture=nobody))


def test_a_bad_run_name_is_refused(memory: Network) -> None:
    partition = Partition.each(grid(1, 1))
    with pytest.raises(RunNameError):
        Coordinator(memory.endpoint(), partition, "packed", run="a/b", readings=SensorSchema(1), message=None)
